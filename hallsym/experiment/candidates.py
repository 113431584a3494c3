"""Runs that could be recorded: vertical settings times trajectories, without what is excluded."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from hallsym.errors import InputError
from hallsym.experiment.ranges import Box, Ranges, tidy
from hallsym.model import Model
from hallsym.simulation import Run, Signal, sine
from hallsym.units import readable

MOST = 20_000
"""Candidates beyond this are refused: fewer levels say the same."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A run that could be recorded, and what a table calls its setting and its trajectory."""

    run: Run
    setting: str
    trajectory: str


@dataclass(frozen=True, eq=False)
class _Motion:
    """Signals by axis, how far each axis goes from the middle, and the name of the trajectory."""

    name: str
    signals: Mapping[str, Signal]
    reach: Mapping[str, float]


def candidates(ranges: Ranges, model: Model) -> tuple[Candidate, ...]:
    """Return every run of `model` that the ranges allow; raises `InputError` when there is none.

    Its pose moves; its state is held at settings.
    """
    _check_axes(ranges, model)
    found: list[Candidate] = []
    held = [axis for axis in model.state if axis in ranges.box]
    for motion in _motions(ranges, model):
        for setting in _settings(ranges, model):
            if not any(_touches(zone, setting, motion) for zone in ranges.excluded):
                place = {axis: value for axis, value in setting.items() if value or axis in held}
                words = _words(place, motion, model)
                run = Run(ranges.seconds_per_run, place, motion.signals, name=f"{words}; {motion.name}")
                found.append(Candidate(run, words, motion.name))
            if len(found) > MOST:
                raise InputError(f"These ranges make more than {MOST} candidate runs; lower 'levels'.")
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
    """Refuse ranges of axes that the model has not, or in which its pose stands still."""
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


def _motions(ranges: Ranges, model: Model) -> Iterator[_Motion]:
    moving = [axis for axis in model.pose if ranges.place(axis)[1] > 0]
    f, wanted = ranges.frequencies_hz, ranges.trajectories
    if "one-axis" in wanted:
        for axis in moving:
            yield _sines(ranges, (axis,), f)
    if "combined" in wanted:
        for n in range(2, len(moving) + 1):
            for axes in combinations(moving, n) if n <= len(f) else ():
                yield _sines(ranges, axes, f)


def _sines(ranges: Ranges, axes: Sequence[str], frequencies: Sequence[float]) -> _Motion:
    pairs = list(zip(axes, frequencies, strict=False))
    reach = {axis: ranges.place(axis)[1] for axis in axes}
    name = ", ".join(f"{_axis(axis)} {f:g} Hz" for axis, f in pairs)
    return _Motion(name, {axis: sine(reach[axis], f) for axis, f in pairs}, reach)


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


def _touches(zone: Box, setting: Mapping[str, float], motion: _Motion) -> bool:
    """Whether the run comes into the zone on every axis that the zone names."""
    return all(
        setting[axis] - motion.reach.get(axis, 0.0) <= high
        and setting[axis] + motion.reach.get(axis, 0.0) >= low
        for axis, (low, high) in zone.items()
    )


def _words(place: Mapping[str, float], motion: _Motion, model: Model) -> str:
    parts = []
    for axis, value in place.items():
        factor, unit, _ = readable(axis, model.period)
        about = "about " if axis in motion.signals else ""
        if value:
            parts.append(f"{_axis(axis)} {about}{factor * value:+.4g} {unit}")
    return ", ".join(parts) or "level"


def _axis(axis: str) -> str:
    name = axis.rpartition("_")[0]
    return name if name in ("x", "y") else name.capitalize()
