"""What a calibration cannot know of the use of a sensor: averaging, ADC, zeroing, vertical sensors, scale."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.model import Model
from hallsym.toml import Table, number, unit_of, whole
from hallsym.units import si_unit, split_unit

SECTIONS = ("coverage_factor", "level", "reading", "zeroing", "state", "reference")


Zeroed = tuple[np.ndarray, np.ndarray]
"""Pose (n_pose,) and state (n_state,) of the zeroing."""


class Variances(Protocol):
    """Sources that no calibration holds, such as the error of its model (`model_error.ModelError`)."""

    def variances(
        self, fit: Any, pose: np.ndarray, state: np.ndarray, zero: Zeroed, places: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Return the variance of each source, (s, n_pose), at poses (n_pose, s) and states (n_state, s)."""


@dataclass(frozen=True, eq=False)
class Settings:
    """How positions are taken, in SI; everything has a default.

    `averaged`: readings averaged in one position. `adc_step`: step of the converter in the unit of a
    reading, 0 for none. `zero_averaged`: readings averaged at the zeroing. `zero_pose_std`: pose column ->
    standard uncertainty of the pose at the zeroing; the noise of the reference, averaged as the readings
    are, where not given. `zero_at`: pose or state column -> where the zeroing is done, 0 where not given.
    `state_std`: state column -> standard uncertainty besides noise, of the vertical sensors since the
    calibration. `scale_std`: pose column -> relative standard uncertainty of the scale of the reference.
    `model_error`: what the model leaves, of a diagnosis. `coverage` and `level` as in `Budget`.
    """

    averaged: int = 1
    adc_step: float = 0.0
    zero_averaged: int = 1
    zero_pose_std: Mapping[str, float] = field(default_factory=dict)
    zero_at: Mapping[str, float] = field(default_factory=dict)
    state_std: Mapping[str, float] = field(default_factory=dict)
    scale_std: Mapping[str, float] = field(default_factory=dict)
    model_error: Variances | None = None
    coverage: float = 2.0
    level: float | None = None

    def checked(self, model: Model) -> "Settings":
        """Return these settings; columns that `model` has not and impossible numbers are an `InputError`."""
        for name in ("averaged", "zero_averaged"):
            whole(getattr(self, name), name, "the budget's settings")
        number(self.adc_step, "adc_step", "the budget's settings", 0.0)
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
                number(value, column, f"setting '{name}'", -np.inf if name == "zero_at" else 0.0)
        return self


def read_settings(path: str | Path, model: Model) -> Settings:
    """Read `[reading]`, `[zeroing]`, `[zeroing.at]`, `[state]` and `[reference]` from TOML (docs/budget.md).

    Units are in the keys: `adc_step_nm`, `z_nm`, `x_scale_ppm`. Raises `InputError` for a missing file,
    unknown keys and impossible numbers.
    """
    file = Table.read(path, "Settings file", SECTIONS)
    coverage, level = coverage_of(file)
    reading, zeroing, state, reference = (
        file.table(key) for key in ("reading", "zeroing", "state", "reference")
    )
    at = zeroing.table("at")
    return Settings(
        averaged=reading.whole("averaged", 1),
        adc_step=_adc_step(reading, model),
        zero_averaged=zeroing.whole("averaged", 1),
        zero_pose_std=_sizes(zeroing, model.pose, ("averaged", "at")),
        zero_at={c: at.number(key) * factor for key, c, factor in at.columns((*model.pose, *model.state))},
        state_std=_sizes(state, model.state),
        scale_std=_scales(reference, model),
        coverage=coverage,
        level=level,
    )


def coverage_of(file: Table) -> tuple[float, float | None]:
    """Return the coverage factor, 2 by default, and the level of a file that may state one of them."""
    if "coverage_factor" in file and "level" in file:
        raise InputError(f"In {file.where} give 'coverage_factor' or 'level', not both.")
    return file.number("coverage_factor", 2.0), file.number("level") if "level" in file else None


def _sizes(raw: Table, columns: tuple[str, ...], but: tuple[str, ...] = ()) -> dict[str, float]:
    return {c: raw.number(key, least=0.0) * factor for key, c, factor in raw.columns(columns, but)}


def _scales(raw: Table, model: Model) -> dict[str, float]:
    """`x_scale_ppm = 2` for each pose coordinate."""
    stems = {f"{split_unit(column)[0]}_scale": column for column in model.pose}
    found = {}
    for key in raw.raw:
        stem, _, suffix = key.rpartition("_")
        if stem not in stems or suffix not in ("ppm", "percent"):
            wanted = [f"{s}_ppm" for s in stems]
            raise InputError(
                f"Unknown key {key!r} in {raw.where}{nearest(key, wanted)}; known are {', '.join(wanted)}."
            )
        found[stems[stem]] = raw.number(key, least=0.0) * unit_of(suffix, raw.where)[1]
    return found


def _adc_step(raw: Table, model: Model) -> float:
    """Return the step of the converter [SI], stated or from bits and range; 0 for none."""
    units = {si_unit(column) for column in model.channels} - {""}
    sized = {key: kind for key in raw.raw for kind in ("adc_step", "adc_range") if key.startswith(f"{kind}_")}
    others = {k: v for k, v in raw.raw.items() if k not in sized}
    Table(others, raw.where, ("averaged", "adc_bits", "adc_step_nm", "adc_range_mm"))
    found: dict[str, float] = {}
    for key, kind in sized.items():
        si, factor = unit_of(key.removeprefix(f"{kind}_"), raw.where)
        if si not in units:
            raise InputError(f"'{key}' of {raw.where} must be in the unit of a reading ({', '.join(units)}).")
        found[kind] = raw.number(key, least=0.0) * factor
    given = sorted([*sized.values(), *(["adc_bits"] if "adc_bits" in raw else [])])
    if given not in ([], ["adc_step"], ["adc_bits", "adc_range"]):
        raise InputError(
            f"In {raw.where} give either 'adc_step_nm', or 'adc_bits' with 'adc_range_mm'; "
            "one of them is missing or too much."
        )
    if "adc_range" in found:
        return found["adc_range"] / 2.0 ** raw.whole("adc_bits")
    return found.get("adc_step", 0.0)
