"""What a log says of itself beside its samples (`meta.json`)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hallsym.errors import InputError


@dataclass(frozen=True, eq=False)
class Meta:
    """Facts about a campaign; everything is optional and `raw` keeps the file's own words.

    `holdout` holds run ids to judge on, `nominal` design values by parameter name, `probes` one entry per
    channel with `channel`, `position_m` and `senses`; `gap_length_scale_m` turns rotation into length and
    `gap_threshold_rel` is the relative improvement that is worth reporting.
    """

    case_id: str | None = None
    family: str | None = None
    base_model: str | None = None
    nominal: dict[str, Any] = field(default_factory=dict)
    probes: list[dict[str, Any]] | None = None
    holdout: tuple[int, ...] = ()
    gap_metric: str | None = None
    gap_length_scale_m: float | None = None
    gap_threshold_rel: float | None = None
    sampling_clock_s: float | None = None
    noise_1sigma: dict[str, float] = field(default_factory=dict)
    raw: dict[str, Any] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    """SI columns of the log it belongs to, which say in what form the sensor was read."""

    @staticmethod
    def from_dict(raw: Mapping[str, Any], where: str = "meta") -> Meta:
        """Build from the keys of a `meta.json`; unknown keys stay in `raw`."""
        entries = {
            name: _typed(raw, name, kind, where) for name, kind in _KINDS.items() if raw.get(name) is not None
        }
        runs = entries.pop("validation_runs", ())
        if not all(isinstance(run, int) for run in runs):
            raise InputError(f"Key 'validation_runs' of {where} must be a list of run numbers.")
        for key, value in entries.get("noise_1sigma", {}).items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                raise InputError(
                    f"Key 'noise_1sigma' of {where} must hold positive numbers; {key} is {value!r}."
                )
        return Meta(holdout=tuple(runs), raw=dict(raw), **entries)

    @staticmethod
    def read(path: Path) -> Meta:
        """Read a `meta.json`."""
        try:
            raw = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"Cannot read {path}: {' '.join(str(error).split())}.") from error
        if not isinstance(raw, dict):
            raise InputError(f"{path} must hold a JSON object; it holds a {type(raw).__name__}.")
        return Meta.from_dict(raw, str(path))


_NUMBER = (int, float)
_KINDS: dict[str, type | tuple[type, ...]] = {
    "case_id": str, "family": str, "base_model": str, "nominal": dict, "probes": list,
    "validation_runs": list, "gap_metric": str, "gap_length_scale_m": _NUMBER, "gap_threshold_rel": _NUMBER,
    "sampling_clock_s": _NUMBER, "noise_1sigma": dict,
}  # fmt: skip


def _typed(raw: Mapping[str, Any], name: str, kind: type | tuple[type, ...], where: str) -> Any:
    value = raw[name]
    if not isinstance(value, kind) or isinstance(value, bool):
        wanted = "number" if isinstance(kind, tuple) else kind.__name__
        raise InputError(f"Key '{name}' of {where} must be a {wanted}; instead received {value!r}.")
    return value
