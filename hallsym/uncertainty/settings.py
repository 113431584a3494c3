"""What a calibration cannot know of the use of a sensor: averaging, ADC, zeroing, vertical sensors, scale."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.model import Model
from hallsym.toml import known, number, read_toml
from hallsym.uncertainty.files import size, unit_of
from hallsym.units import split_unit

SECTIONS = ("coverage_factor", "level", "reading", "zeroing", "state", "reference")


@dataclass(frozen=True, eq=False)
class Settings:
    """How positions are taken, in SI; everything has a default.

    `averaged`: readings averaged in one position. `adc_step`: step of the converter in the unit of a
    reading, 0 for none. `zero_averaged`: readings averaged at the zeroing. `zero_pose_std`: pose column ->
    standard uncertainty of the pose at the zeroing; the noise of the reference, averaged as the readings
    are, where not given. `zero_at`: pose or state column -> where the zeroing is done, 0 where not given.
    `state_std`: state column -> standard uncertainty besides noise, of the vertical sensors since the
    calibration. `scale_std`: pose column -> relative standard uncertainty of the scale of the reference.
    `coverage` and `level` as in `Budget`.
    """

    averaged: int = 1
    adc_step: float = 0.0
    zero_averaged: int = 1
    zero_pose_std: Mapping[str, float] = field(default_factory=dict)
    zero_at: Mapping[str, float] = field(default_factory=dict)
    state_std: Mapping[str, float] = field(default_factory=dict)
    scale_std: Mapping[str, float] = field(default_factory=dict)
    coverage: float = 2.0
    level: float | None = None

    def checked(self, model: Model) -> "Settings":
        """Return these settings; columns that `model` has not and impossible numbers are an `InputError`."""
        for name in ("averaged", "zero_averaged"):
            _count(getattr(self, name), name, "the budget's settings")
        size(self.adc_step, "adc_step", "the budget's settings")
        columns = {
            "zero_pose_std": model.pose,
            "zero_at": (*model.pose, *model.state),
            "state_std": model.state,
            "scale_std": model.pose,
        }
        for name, allowed in columns.items():
            for column, value in getattr(self, name).items():
                if column not in allowed:
                    raise InputError(
                        f"Setting '{name}' must hold columns of {model.name} ({', '.join(allowed)}); "
                        f"instead received {column!r}{nearest(column, list(allowed))}."
                    )
                (number if name == "zero_at" else size)(value, column, f"setting '{name}'")
        return self


def read_settings(path: str | Path, model: Model) -> Settings:
    """Read `[reading]`, `[zeroing]`, `[zeroing.at]`, `[state]` and `[reference]` from TOML (docs/budget.md).

    Units are in the keys: `adc_step_nm`, `z_nm`, `x_scale_ppm`. Raises `InputError` for a missing file,
    unknown keys and impossible numbers.
    """
    raw, where = read_toml(Path(path), "Settings file"), f"settings {Path(path).name}"
    known(raw, SECTIONS, where)
    if "coverage_factor" in raw and "level" in raw:
        raise InputError(f"In {where} give 'coverage_factor' or 'level', not both.")
    reading, zeroing, state, reference = (
        _section(raw.get(key, {}), key, where) for key in ("reading", "zeroing", "state", "reference")
    )
    zeroing = dict(zeroing)
    at = _section(zeroing.pop("at", {}), "zeroing.at", where)
    averaged, step = _reading(reading, model, f"[reading] of {where}")
    spot = f"[zeroing] of {where}"
    zero_averaged = _count(zeroing.pop("averaged", 1), "averaged", spot)
    return Settings(
        averaged=averaged,
        adc_step=step,
        zero_averaged=zero_averaged,
        zero_pose_std=_columns(zeroing, model.pose, spot, ("averaged",)),
        zero_at=_columns(at, (*model.pose, *model.state), f"[zeroing.at] of {where}", signed=True),
        state_std=_columns(state, model.state, f"[state] of {where}"),
        scale_std=_scales(reference, model, f"[reference] of {where}"),
        coverage=number(raw.get("coverage_factor", 2.0), "coverage_factor", where),
        level=None if "level" not in raw else number(raw["level"], "level", where),
    )


def column_value(key: str, columns: tuple[str, ...], where: str) -> tuple[str, float]:
    """Return the column that `key` names in any unit, and the factor to SI: `z_um` is `z_m`, 1e-6."""
    stem, unit = split_unit(key)
    for column in columns:
        ours, si = split_unit(column)
        if ours == stem:
            if unit is None or si is None or unit.si != si.si:
                raise InputError(f"'{key}' of {where} must end with a unit of {ours!r}, such as {column!r}.")
            return column, unit.factor
    raise InputError(
        f"Unknown key {key!r} in {where}{nearest(key, list(columns))}; known are {', '.join(columns)} "
        "(in any unit)."
    )


def _columns(
    raw: Mapping[str, Any],
    columns: tuple[str, ...],
    where: str,
    others: tuple[str, ...] = (),
    signed: bool = False,
) -> dict[str, float]:
    found: dict[str, float] = {}
    for key, value in raw.items():
        column, factor = column_value(key, columns, where)
        if column in found:
            raise InputError(f"'{key}' of {where} is given twice; keep one.")
        found[column] = (number if signed else size)(value, key, where) * factor
    return found


def _scales(raw: Mapping[str, Any], model: Model, where: str) -> dict[str, float]:
    """`x_scale_ppm = 2` for each pose coordinate."""
    stems = {f"{split_unit(column)[0]}_scale": column for column in model.pose}
    found = {}
    for key, value in raw.items():
        stem, _, suffix = key.rpartition("_")
        if stem not in stems or suffix not in ("ppm", "percent"):
            wanted = [f"{s}_ppm" for s in stems]
            raise InputError(
                f"Unknown key {key!r} in {where}{nearest(key, wanted)}; known are {', '.join(wanted)}."
            )
        found[stems[stem]] = size(value, key, where) * unit_of(suffix, where)[1]
    return found


def _reading(raw: Mapping[str, Any], model: Model, where: str) -> tuple[int, float]:
    """Readings averaged, and the ADC step from a step or from bits and range."""
    units = {unit.si for _, unit in map(split_unit, model.channels) if unit}
    lengths = {key: key.removeprefix(kind) for key in raw for kind in ("adc_step_", "adc_range_")
               if key.startswith(kind)}  # fmt: skip
    known({k: v for k, v in raw.items() if k not in lengths},
          ("averaged", "adc_bits", "adc_step_nm", "adc_range_mm"), where)  # fmt: skip
    for key, suffix in lengths.items():
        if unit_of(suffix, where)[0] not in units:
            raise InputError(f"'{key}' of {where} must be in the unit of a reading ({', '.join(units)}).")
    steps, spans = ([key for key in lengths if key.startswith(f"adc_{kind}_")] for kind in ("step", "range"))
    averaged = _count(raw.get("averaged", 1), "averaged", where)
    if len(steps) > 1 or (steps and (spans or "adc_bits" in raw)) or len(spans) != ("adc_bits" in raw):
        raise InputError(
            f"In {where} give either 'adc_step_nm', or 'adc_bits' with 'adc_range_mm'; "
            "one of them is missing or too much."
        )
    if steps:
        return averaged, size(raw[steps[0]], steps[0], where) * unit_of(lengths[steps[0]], where)[1]
    if spans:
        bits = _count(raw["adc_bits"], "adc_bits", where)
        span = size(raw[spans[0]], spans[0], where) * unit_of(lengths[spans[0]], where)[1]
        return averaged, span / 2.0**bits
    return averaged, 0.0


def _section(raw: Any, key: str, where: str) -> Mapping[str, Any]:
    if not isinstance(raw, Mapping):
        raise InputError(f"'{key}' of {where} must be a table [{key}]; instead received {raw!r}.")
    return raw


def _count(value: Any, key: str, where: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise InputError(f"'{key}' of {where} must be a whole number, 1 or more; instead received {value!r}.")
    return int(value)
