"""Admissible recordings: ranges of the axes, clock, time, frequencies (docs/plan.md), and the runs within."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations, product
from pathlib import Path

import numpy as np

from hallsym.errors import InputError, require
from hallsym.families import axes, published
from hallsym.model import Model
from hallsym.simulation import MOST_SAMPLES, Run, noise_table, sine
from hallsym.toml import Table, positive
from hallsym.units import readable

TRAJECTORIES = ("one-axis", "combined")
KEYS = (
    "step_s", "seconds_per_run", "runs", "minutes", "reset_s", "frequencies_hz", "levels", "trajectories",
    "range", "exclude", "noise", "reference",
)  # fmt: skip
MOST_LEVELS = 1000
"""Of one axis: more make too many candidates whatever else is asked for."""
Box = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Ranges:
    """Admissible recordings.

    `box`: lowest and highest position of each axis [m, rad]; an axis that is not named rests at 0.
    `excluded`: boxes that no run may touch. `levels` of each vertical axis between its ends, ends included.
    `frequencies_hz` of the motion. `trajectories`: of `TRAJECTORIES`. `runs`, `minutes`: limits, None for no
    limit. `reset_s`: time between two runs. `noise`: 1 sigma by column, may be empty. `reference`: unit of
    uncertainty of each pose coordinate in the criterion max-u; 1 um and 1 urad where not stated.
    """

    box: Box
    frequencies_hz: tuple[float, ...]
    seconds_per_run: float
    step_s: float = 2e-3
    levels: int = 5
    excluded: tuple[Box, ...] = ()
    trajectories: tuple[str, ...] = TRAJECTORIES
    runs: int | None = None
    minutes: float | None = None
    reset_s: float | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    reference: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse ranges within which nothing can be recorded."""
        for axis, (low, high) in self.box.items():
            require(low <= high, f"Range of {axis}", "given from low to high", [low, high])
        samples = self.seconds_per_run / self.step_s
        if samples > MOST_SAMPLES:
            raise InputError(
                f"A run must have at most {MOST_SAMPLES:g} samples; {self.seconds_per_run:g} s at "
                f"{self.step_s:g} s are {samples:.3g}: raise 'step_s' or lower 'seconds_per_run'."
            )
        limit = 0.5 / self.step_s
        known, wanted = self.frequencies_hz, f"given, and below half the sampling rate, {limit:g} Hz"
        require(known and max(known) < limit, "Frequencies", wanted, list(known))
        if self.seconds_per_run * min(self.frequencies_hz) < 0.5:
            raise InputError(
                f"A run of {self.seconds_per_run:g} s is shorter than half a period of its lowest frequency, "
                f"{min(self.frequencies_hz):g} Hz: raise 'seconds_per_run' or the frequency."
            )

    def place(self, axis: str) -> tuple[float, float]:
        """Middle and half width of an axis; 0, 0 where it has no range."""
        low, high = self.box.get(axis, (0.0, 0.0))
        return tidy(0.5 * (low + high)), tidy(0.5 * (high - low))

    def references(self, pose: tuple[str, ...]) -> np.ndarray:
        """Return the unit of uncertainty of each pose coordinate, (n_pose,), SI."""
        return np.array([self.reference.get(c, 1e-6) for c in pose])

    def allowed(self, runs: int | None, minutes: float | None) -> int:
        """Return how many runs may be recorded: `runs` or as many as fit in `minutes`, the fewer.

        What is None is taken from the file. Raises `InputError` when nothing fits or nothing is stated.
        """
        for name, value in (("runs", runs), ("minutes", minutes)):
            known = value is None or 0 < value < np.inf
            require(known, f"'{name}' of a plan", "a positive number", value)
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
    file = Table.read(path, "Ranges file", KEYS)
    for key in ("range", "frequencies_hz", "seconds_per_run", "step_s"):
        if key not in file:
            raise InputError(f"Key '{key}' is missing in {file.where}; nothing is assumed for it.")
    reference, levels = file.table("reference"), file.whole("levels", 5, least=2)
    require(levels <= MOST_LEVELS, f"'levels' of {file.where}", f"{MOST_LEVELS} at most", levels)
    return Ranges(
        box=_box(file.table("range")),
        frequencies_hz=tuple(sorted(file.numbers("frequencies_hz", positive))),
        seconds_per_run=file.positive("seconds_per_run"),
        step_s=file.positive("step_s"),
        levels=levels,
        excluded=tuple(map(_box, file.tables("exclude"))),
        trajectories=_trajectories(file),
        runs=file.whole("runs") if "runs" in file else None,
        minutes=file.positive("minutes") if "minutes" in file else None,
        reset_s=file.number("reset_s", least=0.0) if "reset_s" in file else None,
        noise=noise_table(file),
        reference={c: reference.positive(key) * factor for key, c, factor in reference.columns(axes())},
    )


def _box(raw: Table) -> dict[str, tuple[float, float]]:
    box = {}
    for key, axis, factor in raw.columns(axes()):
        low, high = raw.pair(key)
        box[axis] = (tidy(low * factor), tidy(high * factor))
    if not box:
        raise InputError(f"{raw.where} is empty; give axes such as z_um = [-250, 250].")
    return box


def _trajectories(file: Table) -> tuple[str, ...]:
    value = file.raw.get("trajectories", list(TRAJECTORIES))
    what, listed = f"'trajectories' of {file.where}", ", ".join(TRAJECTORIES)
    for name in value if isinstance(value, list) else [value]:
        require(name in TRAJECTORIES, what, f"a list of {listed}", name, TRAJECTORIES)
    require(isinstance(value, list) and value, what, "a list that is not empty", value)
    return tuple(value)


def corners(box: Box, axes: tuple[str, ...]) -> np.ndarray:
    """Return corners, face centres and centre of the box, shape (points, axes)."""
    low, high = (np.array([box.get(a, (0.0, 0.0))[k] for a in axes]) for k in (0, 1))
    unit = np.array(np.meshgrid(*[[-1.0, 1.0]] * len(axes))).reshape(len(axes), -1).T
    faces = np.vstack([np.eye(len(axes)), -np.eye(len(axes)), np.zeros((1, len(axes)))])
    points = 0.5 * (low + high) + 0.5 * (high - low) * np.vstack([unit, faces])
    return np.unique(points, axis=0)


# -- the runs within: vertical settings times trajectories, without what is excluded ------------------------

MOST_CANDIDATES = 20_000
"""Candidates beyond this are refused: fewer levels say the same."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A run that could be recorded, with the names of its setting and its trajectory."""

    run: Run
    setting: str
    trajectory: str


def candidates(ranges: Ranges, model: Model) -> tuple[Candidate, ...]:
    """Return every run of `model` that the ranges allow; raises `InputError` when there is none.

    Its pose moves; its state rests at settings.
    """
    _check_axes(ranges, model)
    found: list[Candidate] = []
    steady = [axis for axis in model.state if axis in ranges.box]
    for pairs in _motions(ranges, model):
        signals = {axis: sine(ranges.place(axis)[1], f) for axis, f in pairs}
        motion = ", ".join(f"{_axis(axis)} {f:g} Hz" for axis, f in pairs)
        for setting in _settings(ranges, model):
            if not any(_touches(zone, setting, signals, ranges) for zone in ranges.excluded):
                place = {axis: value for axis, value in setting.items() if value or axis in steady}
                words = _words(place, signals, model)
                run = Run(ranges.seconds_per_run, place, signals, name=f"{words}; {motion}")
                found.append(Candidate(run, words, motion))
            if len(found) > MOST_CANDIDATES:
                raise InputError(
                    f"These ranges make more than {MOST_CANDIDATES} candidate runs; lower 'levels'."
                )
    if not found and not ranges.excluded:
        wanted = ", ".join(ranges.trajectories)
        raise InputError(
            f"Trajectories {wanted} cannot be made of {len(ranges.frequencies_hz)} frequencies; give one "
            "frequency for every axis that moves, or allow 'one-axis'."
        )
    if not found:
        raise InputError(
            "No admissible setting is left: every candidate run touches an [[exclude]] zone; make the zones "
            "smaller, the ranges wider or 'levels' more."
        )
    return tuple(found)


def _check_axes(ranges: Ranges, model: Model) -> None:
    """Refuse ranges of axes that the model does not have, or in which its pose rests."""
    own = (*model.pose, *model.state)
    for axis in (*ranges.box, *(a for zone in ranges.excluded for a in zone)):
        if axis not in own:
            raise InputError(f"Ranges move {axis}, which {model.name} has not; it has {', '.join(own)}.")
    for axis in ranges.reference:
        if axis not in model.pose:
            raise InputError(
                f"[reference] {axis} of the ranges must be a coordinate of {model.name}: "
                f"{', '.join(model.pose)}."
            )
    if not any(ranges.place(axis)[1] > 0 for axis in model.pose):
        names = [_axis(axis) for axis in model.pose]
        listed = " or ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)
        raise InputError(
            f"Ranges must let {listed} move: give one of them a range that is not empty, such as "
            "x_um = [-300, 300]."
        )


def _motions(ranges: Ranges, model: Model) -> Iterator[list[tuple[str, float]]]:
    """Axes that move together, each with its frequency."""
    moving = [axis for axis in model.pose if ranges.place(axis)[1] > 0]
    f, wanted = ranges.frequencies_hz, ranges.trajectories
    least, most = 1 if "one-axis" in wanted else 2, len(f) if "combined" in wanted else 1
    for n in range(least, most + 1):
        yield from (list(zip(axes, f, strict=False)) for axes in combinations(moving, n))


def _settings(ranges: Ranges, model: Model) -> Iterator[dict[str, float]]:
    """Grid over the vertical axes; every other axis at the middle of its range."""
    middle = {axis: ranges.place(axis)[0] for axis in model.pose}
    levels = []
    for axis in model.state:
        centre, half = ranges.place(axis)
        shares = np.linspace(-1, 1, ranges.levels) if half else [0.0]
        levels.append([tidy(centre + half * s) for s in shares])
    for place in product(*levels):
        yield middle | dict(zip(model.state, place, strict=True))


def _touches(zone: Box, setting: Mapping[str, float], moved: Collection[str], ranges: Ranges) -> bool:
    """Whether the run enters the zone on every axis that the zone names."""
    reach = {axis: ranges.place(axis)[1] if axis in moved else 0.0 for axis in zone}
    return all(
        setting[axis] - reach[axis] <= high and setting[axis] + reach[axis] >= low
        for axis, (low, high) in zone.items()
    )


def _words(place: Mapping[str, float], moved: Collection[str], model: Model) -> str:
    parts = []
    for axis, value in place.items():
        factor, unit, _ = readable(axis, model.period)
        about = "about " if axis in moved else ""
        if value:
            parts.append(f"{_axis(axis)} {about}{factor * value:+.4g} {unit}")
    return ", ".join(parts) or "level"


def _axis(axis: str) -> str:
    name = axis.rpartition("_")[0]
    return name if name in ("x", "y") else name.capitalize()
