"""What may be recorded: ranges of the axes, clock, time, frequencies (docs/plan.md)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.families import axes, published
from hallsym.simulation import noise_table
from hallsym.toml import known, number, numbers, positive, read_toml, table, tables
from hallsym.units import UNITS, split_unit

TRAJECTORIES = ("one-axis", "combined", "multi-sine", "raster")
KEYS = (
    "step_s", "seconds_per_run", "runs", "minutes", "reset_s", "frequencies_hz", "levels", "trajectories",
    "vertical_motion", "range", "exclude", "noise", "reference",
)  # fmt: skip
Box = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Ranges:
    """What may be recorded.

    `box`: lowest and highest position of each axis [m, rad]; an axis that is not named rests at 0.
    `excluded`: boxes that no run may touch. `levels` of each vertical axis between its ends, ends included.
    `frequencies_hz` of the motion. `trajectories`: of `TRAJECTORIES`. `vertical_motion`: vertical axes may
    move within a run. `runs`, `minutes`: how much may be recorded; None where it is not limited. `reset_s`:
    time between two runs. `noise`: 1 sigma by column, may be empty. `reference`: what counts as one unit of
    uncertainty of each pose coordinate in the criterion max-u; 1 um and 1 urad where not stated.
    """

    box: Box
    frequencies_hz: tuple[float, ...]
    seconds_per_run: float
    step_s: float = 2e-3
    levels: int = 5
    excluded: tuple[Box, ...] = ()
    trajectories: tuple[str, ...] = TRAJECTORIES
    vertical_motion: bool = False
    runs: int | None = None
    minutes: float | None = None
    reset_s: float | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    reference: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse ranges within which nothing can be recorded."""
        for axis, (low, high) in self.box.items():
            if not low <= high:
                raise InputError(
                    f"Range of {axis} must run from low to high; instead received {low:g} to {high:g}."
                )
        limit = 0.5 / self.step_s
        if not self.frequencies_hz or max(self.frequencies_hz) >= limit:
            raise InputError(
                f"Frequencies must be given and lie below half the sampling rate, {limit:g} Hz; instead "
                f"received {list(self.frequencies_hz)!r}."
            )
        if self.seconds_per_run * min(self.frequencies_hz) < 0.5:
            raise InputError(
                f"A run of {self.seconds_per_run:g} s is shorter than half a period of its lowest frequency, "
                f"{min(self.frequencies_hz):g} Hz: raise 'seconds_per_run' or the frequency."
            )

    def place(self, axis: str) -> tuple[float, float]:
        """Middle and half width of an axis; 0, 0 where it has no range."""
        low, high = self.box.get(axis, (0.0, 0.0))
        return tidy(0.5 * (low + high)), tidy(0.5 * (high - low))

    def allowed(self, runs: int | None, minutes: float | None) -> int:
        """Return how many runs may be recorded: `runs` or as many as fit in `minutes`, the fewer.

        What is None is taken from the file. Raises `InputError` when nothing fits or nothing is stated.
        """
        for name, value in (("runs", runs), ("minutes", minutes)):
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"'{name}' of a plan must be a positive number; instead received {value!r}.")
        runs, minutes = runs or self.runs, minutes or self.minutes
        if runs is None and minutes is None:
            raise InputError(
                "A plan needs 'runs' or 'minutes': state one in the ranges file or as an option."
            )
        if minutes is None:
            return int(runs or 0)
        if self.reset_s is None:
            raise InputError(
                "A plan by 'minutes' needs 'reset_s', the time between two runs in s; add it to the ranges."
            )
        each = self.seconds_per_run + self.reset_s
        fit = int((60.0 * minutes + self.reset_s) / each + 1e-9)  # no reset after the last run
        if fit < 1:
            raise InputError(
                f"{minutes:g} minutes are too short for one run of {self.seconds_per_run:g} s; allow at "
                f"least {self.seconds_per_run / 60:.3g} minutes or shorten 'seconds_per_run'."
            )
        return fit if runs is None else min(runs, fit)


def tidy(value: float) -> float:
    """Return `value` to 12 digits, so that a file says 0.0001 and not 9.999999999999999e-05."""
    return float(f"{value:.12g}")


def paper_ranges() -> Ranges:
    """Return the ranges of the paper's campaign (Table 6 and Section 5), 57 runs of 1 s on a 2 ms clock.

    Frequencies are 1, 2 and 3 Hz, so that axes can move together; the paper has 1 Hz, one axis at a time.
    """
    settings = published.table("table6_settings")
    box = {axis: (min(settings[axis]), max(settings[axis])) for axis in settings if axis != "setting"}
    box |= {"x_m": (-300e-6, 300e-6), "y_m": (-500e-6, 500e-6), "rz_rad": (-300e-6, 300e-6)}
    return Ranges(box, (1.0, 2.0, 3.0), seconds_per_run=1.0, runs=57)


def read_ranges(path: str | Path) -> Ranges:
    """Read ranges from TOML. Raises `InputError` for unknown keys and for values that cannot be."""
    path = Path(path)
    raw = read_toml(path, "Ranges file")
    where = f"ranges {path.name}"
    known(raw, KEYS, where)
    for key in ("range", "frequencies_hz", "seconds_per_run", "step_s"):
        if key not in raw:
            raise InputError(f"Key '{key}' is missing in {where}; nothing is assumed for it.")
    return Ranges(
        box=_box(raw["range"], "range", where),
        frequencies_hz=tuple(sorted(numbers(raw["frequencies_hz"], "frequencies_hz", where, positive))),
        seconds_per_run=positive(raw["seconds_per_run"], "seconds_per_run", where),
        step_s=positive(raw["step_s"], "step_s", where),
        levels=_whole(raw.get("levels", 5), "levels", where, least=2),
        excluded=tuple(
            _box(entry, "exclude", where) for entry in tables(raw.get("exclude", []), "exclude", where)
        ),
        trajectories=_trajectories(raw.get("trajectories", list(TRAJECTORIES)), where),
        vertical_motion=_switch(raw.get("vertical_motion", False), "vertical_motion", where),
        runs=None if "runs" not in raw else _whole(raw["runs"], "runs", where, least=1),
        minutes=None if "minutes" not in raw else positive(raw["minutes"], "minutes", where),
        reset_s=None if "reset_s" not in raw else number(raw["reset_s"], "reset_s", where, least=0.0),
        noise=noise_table(raw, where),
        reference=_reference(raw.get("reference", {}), f"[reference] of {where}"),
    )


def _box(raw: Any, key: str, where: str) -> dict[str, tuple[float, float]]:
    box, where = {}, f"[{key}] of {where}"
    for name, value in table(raw, key, where).items():
        axis, factor = _axis(name, where)
        pair = numbers(value, name, where)
        if len(pair) != 2:
            raise InputError(f"'{name}' of {where} must be [lowest, highest]; instead received {value!r}.")
        if pair[0] > pair[1]:
            raise InputError(f"'{name}' of {where} is inverted: {value!r} must run from lowest to highest.")
        if axis in box:
            raise InputError(f"Axis {axis} of {where} is given twice; keep one.")
        box[axis] = (tidy(pair[0] * factor), tidy(pair[1] * factor))
    if not box:
        raise InputError(f"{where} is empty; give axes such as z_um = [-250, 250].")
    return box


def _reference(raw: Any, where: str) -> dict[str, float]:
    found = {}
    for key, value in table(raw, "reference", where).items():
        axis, factor = _axis(key, where)
        found[axis] = positive(value, key, where) * factor
    return found


def _axis(key: str, where: str) -> tuple[str, float]:
    """Axis and factor to SI of a key such as `z_um`."""
    stem, unit = split_unit(key)
    axis = f"{stem}_{unit.si}" if unit else key
    if axis not in axes():
        names = [f"{a.rpartition('_')[0]}_u{a.rpartition('_')[2]}" for a in axes()]
        raise InputError(
            f"Unknown axis {key!r} in {where}{nearest(key, [*names, *axes()])}; known are {', '.join(names)} "
            f"and their other units."
        )
    return axis, UNITS[unit.name].factor if unit else 1.0


def _whole(value: Any, key: str, where: str, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise InputError(f"'{key}' of {where} must be a whole number >= {least}; instead received {value!r}.")
    return value


def _switch(value: Any, key: str, where: str) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"'{key}' of {where} must be true or false; instead received {value!r}.")
    return value


def _trajectories(value: Any, where: str) -> tuple[str, ...]:
    for name in value if isinstance(value, list) else [value]:
        if name not in TRAJECTORIES:
            raise InputError(
                f"'trajectories' of {where} must be a list of {', '.join(TRAJECTORIES)}; instead received "
                f"{name!r}{nearest(str(name), list(TRAJECTORIES))}."
            )
    if not value or not isinstance(value, list):
        raise InputError(f"'trajectories' of {where} must be a list that is not empty; received {value!r}.")
    return tuple(value)


def corners(box: Box, axes: tuple[str, ...]) -> np.ndarray:
    """Return corners, face centres and centre of the box, shape (points, axes)."""
    low, high = (np.array([box.get(a, (0.0, 0.0))[k] for a in axes]) for k in (0, 1))
    unit = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(axes))).reshape(len(axes), -1).T
    faces = np.vstack([np.eye(len(axes)), -np.eye(len(axes)), np.zeros((1, len(axes)))])
    points = 0.5 * (low + high) + 0.5 * (high - low) * np.vstack([unit, faces])
    return np.unique(points, axis=0)
