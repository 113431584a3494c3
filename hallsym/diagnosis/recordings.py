"""Recordings that could be made next: short runs on the same machine, inside the ranges of its log."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.refit import Refitted, with_model
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.setup import PER_PERIOD
from hallsym.diagnosis.simulated_machine import readings_of
from hallsym.estimation import pseudo_inverse
from hallsym.log import Log
from hallsym.model import Further
from hallsym.simulation import AtTimes, Run, multi_sine, sine

LONGEST = 2000
"""Samples of a simulated run, at most."""
SWING = 0.05
"""Part of a turn over which a shaft is swung to and fro: 18 deg."""
WARM = 5.0
"""Kelvin by which a temperature cycle goes up and down."""

Motion = tuple[str, dict[str, AtTimes]]
"""A motion in words, and by coordinate."""


@dataclass(frozen=True, eq=False)
class Range:
    """What a log moved: amplitude and typical frequency by axis, clock, temperature.

    `amplitude`: half the range of each pose and vertical column [m, rad]; `frequency_hz` of the pose;
    `start_s`, `end_s`: of the log. `speed`: near the highest of the first pose coordinate [its unit per s];
    `turn`: its period, 0 where it cannot go on and on. `step_s`: the usual one, of what turns the shortest.
    `noun`: what the machine is called.
    """

    pose: tuple[str, ...]
    vertical: tuple[str, ...]
    amplitude: dict[str, float]
    centre: dict[str, float]
    frequency_hz: float
    step_s: float
    start_s: float
    end_s: float
    temperature: float | None
    speed: float = 0.0
    turn: float = 0.0
    noun: str = "machine"


@dataclass(frozen=True, eq=False)
class Recording:
    """A run that could be recorded: in words, as motion, and with a temperature over its time [degC]."""

    text: str
    run: Run
    temperature: AtTimes | None = None


def range_of(base: Base) -> Range:
    """Return what the log of `base` moved, from a sample of it."""
    model = base.model
    vertical = tuple(c for c in model.state if c in model.family.axes)
    turn = model.period.get(model.pose[0], 0.0) if model.pose[0] in model.family.endless else 0.0
    names = dict(zip(model.references, model.pose, strict=True)) | {c: c for c in vertical}
    columns = (*names, "temperature_degc", *(f"d1_{c}" for c in model.references))
    seen: dict[str, list[np.ndarray]] = defaultdict(list)
    ends: list[float] = []
    steps: list[float] = []
    for piece in pieces(base, frozenset(base.log.runs)):
        thin = slice(None, None, max(1, len(piece.t) // 256))
        for c in columns:
            if c in piece.data:
                seen[c].append(piece.data[c][thin])
        steps += [float(np.median(np.diff(piece.t)))] if len(piece.t) > 1 else []
        ends += [float(piece.t[0]), float(piece.t[-1])]
    values = {c: np.concatenate(v) for c, v in seen.items()}
    low, high = ({c: float(np.quantile(v, q)) for c, v in values.items()} for q in (0.005, 0.995))
    warm = "temperature_degc"
    typical = [
        float(np.std(values[f"d1_{c}"]) / np.std(values[c])) / (2 * np.pi)
        for c in model.references
        if np.std(values[c]) > 0
    ]
    return Range(
        pose=model.pose,
        vertical=vertical,
        amplitude={name: (high[c] - low[c]) / 2 for c, name in names.items()},
        centre={name: (high[c] + low[c]) / 2 for c, name in names.items()},
        frequency_hz=max(typical, default=1.0),
        step_s=float(np.min(steps) if turn else np.median(steps)),
        start_s=min(ends),
        end_s=max(ends),
        temperature=(high[warm] + low[warm]) / 2 if warm in values else None,
        speed=float(np.quantile(np.abs(values[f"d1_{model.references[0]}"]), 0.95)),
        turn=turn,
        noun=model.family.noun or model.family.name,
    )


def recordings(r: Range) -> list[Recording]:
    """Return what could be recorded, from the plain to the elaborate, none longer than the log."""
    seconds = min(r.end_s - r.start_s, LONGEST * r.step_s)
    turning = r.turn > 0 and r.speed > 0
    away = [c for c in r.pose if not turning and abs(r.centre[c]) > r.amplitude[c]]  # a gap never comes to 0
    level = {c: r.centre[c] for c in (*r.vertical, *away)}
    motions = list(_turns(r, seconds) if turning else _strokes(r, seconds))
    out = [Recording(f"{text} ({seconds:.3g} s)", Run(seconds, level, motion)) for text, motion in motions]
    if r.temperature is not None:
        (text, motion), middle = motions[0], r.temperature
        out.append(
            Recording(
                f"{text} through a temperature cycle of +-{WARM:g} K ({seconds:.3g} s)",
                Run(seconds, level, motion),
                lambda t: middle + WARM * np.sin(2 * np.pi * t / seconds),
            )
        )
    return out


def _turns(r: Range, seconds: float) -> Iterator[Motion]:
    """What a shaft can do: turn at a speed, both ways, swing, rest."""
    fastest = r.turn / (2 * PER_PERIOD * r.step_s)
    v = min(r.speed, fastest)

    def legs(*speeds: float) -> dict[str, AtTimes]:
        """One speed after the other, each for as long."""
        times = np.linspace(0.0, seconds, len(speeds) + 1)
        places = np.concatenate([[0.0], np.cumsum(np.diff(times) * speeds)])
        return {r.pose[0]: lambda t: np.interp(t, times, places)}

    for times in (1.0, 2.0, 4.0, 8.0):
        if times * v <= fastest:
            yield f"turns in both directions at {_speed(times * v, r.turn)}", legs(times * v, -times * v)
    if v > 8.0 * r.turn / seconds:  # two turns each way
        yield f"turns in both directions, slowly, at {_speed(v / 4, r.turn)}", legs(v / 4, -v / 4)
    steps = [s * v for s in (0.25, 0.5, 1.0, 2.0, 4.0) if s * v <= fastest]
    yield (
        f"turns in both directions at {len(steps)} speeds, up to {_speed(steps[-1], r.turn)}",
        legs(*steps, *(-s for s in reversed(steps))),
    )
    yield f"turns in one direction at {_speed(v, r.turn)}", legs(v)
    swing = min(v, SWING * fastest)  # each way long enough to be seen
    shuttles = round(swing * seconds / (2 * SWING * r.turn))
    if shuttles > 1:
        reach = swing * seconds / (2 * shuttles) * 360 / r.turn
        yield (
            f"swings to and fro over {reach:.2g} deg at {_speed(swing, r.turn)}",
            legs(*(swing, -swing) * shuttles),
        )
    yield f"the {r.noun} at rest", legs(0.0)


def _speed(value: float, turn: float) -> str:
    return f"{float(f'{60 * value / turn:.3g}'):g} rpm"


def _strokes(r: Range, seconds: float) -> Iterator[Motion]:
    """What a machine of limited travel can do."""
    fastest = 1.0 / (PER_PERIOD * r.step_s)
    f = min(max(r.frequency_hz, 2.0 / seconds), fastest)
    all_axes = _names(r.pose)
    for times in (1.0, 2.0, 4.0, 8.0):
        if times * f <= fastest:
            yield f"{all_axes} together at {_hz(times * f)}", _sines(r, times * f)
    if f > 8.0 / seconds:
        yield f"{all_axes} together, slowly, at {_hz(f / 4)}", _sines(r, f / 4)
    yield f"{all_axes} together over a fifth of the stroke at {_hz(f)}", _sines(r, f, 0.2)
    tones = [x for x in f * np.array([0.5, 1.0, 2.0, 4.0, 8.0]) if x <= fastest]
    yield (
        f"{all_axes} with {len(tones)} frequencies at once, up to {_hz(tones[-1])}",
        {c: multi_sine(2 * r.amplitude[c], [x * s for x in tones]) for c, s in _spread(r.pose)},
    )
    yield (
        f"{all_axes} at constant speed to and fro, at {_hz(f)}",
        {c: _to_and_fro(r.amplitude[c], f * s) for c, s in _spread(r.pose)},
    )
    for c in r.pose:
        yield f"{_names((c,))} alone at {_hz(f)}", {c: sine(r.amplitude[c], f)}
    yield "everything at rest", {}
    for c in r.vertical:
        if r.amplitude[c] > 0:
            yield (
                f"{_names((c,))} moved within the run while {all_axes} stand still",
                {c: sine(r.amplitude[c], 2.0 / seconds)},
            )
    if all(r.amplitude[c] > 0 for c in r.vertical) and r.vertical:
        slow = {c: sine(r.amplitude[c], (2.0 + k) / seconds) for k, c in enumerate(r.vertical)}
        yield (
            f"{_names(r.vertical)} moved within the run while {all_axes} move at {_hz(f)}",
            {**_sines(r, f), **slow},
        )


def _spread(pose: Sequence[str]) -> Iterator[tuple[str, float]]:
    """Coordinates with their frequencies over the first one's: no two move alike."""
    return ((c, round(0.83**k, 2)) for k, c in enumerate(pose))


def _to_and_fro(amplitude: float, frequency_hz: float) -> AtTimes:
    """Return a triangle with rounded turning points: its first four harmonics, easy to follow."""

    def at(t: np.ndarray) -> np.ndarray:
        x = 2 * np.pi * frequency_hz * t
        waves = [(-1) ** k * np.sin((2 * k + 1) * x) / (2 * k + 1) ** 2 for k in range(4)]
        return amplitude * 8 / np.pi**2 * np.sum(waves, axis=0)

    return at


def _sines(r: Range, frequency_hz: float, part: float = 1.0) -> dict[str, AtTimes]:
    return {c: sine(part * r.amplitude[c], frequency_hz * s) for c, s in _spread(r.pose)}


def _hz(value: float) -> str:
    return f"{value:.2g} Hz"


def _names(columns: Sequence[str]) -> str:
    shown = [c.rpartition("_")[0].capitalize() if c != "x_m" and c != "y_m" else c[0] for c in columns]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


# -- what a further recording of the family tells ------------------------------------------------------------


Told = tuple[list[Recording], np.ndarray]
"""Recordings, and the whitened squared distance that each adds for the closest pair of models."""


def further_recordings(fits: Sequence[Refitted]) -> Told:
    """Return the family's further recordings with what each adds: `fits`, each fitted on the log."""
    first = fits[0].base
    offered = [f for f in first.model.family.further if f.read(first.model) is not None]
    if not offered:
        return [], np.zeros(0)
    motion = _motion(first)
    run, t = motion["run"], motion["t_s"]
    seconds = float(sum(np.ptp(t[run == r]) for r in np.unique(run)))
    told = [min(_told(f, motion, a, b) for a, b in permutations(fits, 2)) for f in offered]
    return [Recording(f"{f.text} ({seconds:.3g} s)", Run(seconds, {}, {})) for f in offered], np.array(told)


def _motion(base: Base) -> dict[str, np.ndarray]:
    """Return all columns but the readings of the first samples of each run that was fitted."""
    runs = [r for r in base.log.runs if r not in base.holdout]
    each = max(1, LONGEST // len(runs))
    run = base.log.array("run").astype(int)
    rows = np.concatenate([np.flatnonzero(run == r)[:each] for r in runs])
    names = [c for c in base.log.columns if c not in (*base.model.channels, "run")]
    return {"run": run[rows]} | {c: base.log.array(c)[rows] for c in names}


def _told(further: Further, motion: dict[str, np.ndarray], a: Refitted, b: Refitted) -> float:
    """Return the squared distance of b from the readings of a, b refitted to log and recording at once."""
    columns = motion | dict(further.moved(motion))
    one, other = (_read_as(further, fit.base) for fit in (a, b))
    if one is None or other is None:
        return 0.0
    return added(
        normal_equations(recording(other, with_readings(columns, one))).likelihood.sum(axis=0), other, b
    )


def recording(base: Base, log: Log) -> Base:
    """Return a model on a recording that was not made yet, zeros at rest."""
    zeros = dict.fromkeys(log.runs, np.zeros(len(base.model.zeros)))
    return replace(base, log=log, zeros=zeros, keep=None, holdout=frozenset[int]())


def added(M: np.ndarray, there: Base, known: Refitted) -> float:
    """Return the squares that products M of a recording add once `there` is fitted to it and to the log.

    `known`: the same model, or one with fewer parameters, fitted to the log.
    """
    n, own = len(there.free), len(known.base.free)
    place = {there.model.names[k]: j for j, k in enumerate(there.free)}
    at = np.array([place[known.base.model.names[k]] for k in known.base.free])
    both = M[:n, :n].copy()
    both[at[:, None], at] += known.tangents.likelihood[known.fitted].sum(axis=0)[:own, :own]
    return max(float(M[n, n] - M[:n, n] @ pseudo_inverse(both) @ M[:n, n]), 0.0)


def _read_as(further: Further, base: Base) -> Base | None:
    model = further.read(base.model)
    return None if model is None else with_model(base, model)


def with_readings(columns: Mapping[str, np.ndarray], base: Base) -> Log:
    """Add the readings that the model of `base` gives; columns that it computes come from the motion."""
    model = base.model
    blank = np.zeros(len(columns["run"]))
    bare = Log.from_arrays({**columns, **dict.fromkeys(model.channels, blank)}, noise=base.log.noise)
    readings = readings_of(replace(base, log=bare, zeros={}), model, base.p)
    return Log.from_arrays(
        {**columns, **dict(zip(model.channels, readings, strict=True))}, noise=base.log.noise
    )
