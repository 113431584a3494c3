"""Recordings that could be made next: short runs on the same machine, inside the ranges of its log."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.diagnosis.residuals import Base, pieces
from hallsym.simulation import AtTimes, Run, multi_sine, sine

LONGEST = 2000
"""Samples of a simulated run, at most."""
LENGTH = 8.0
"""Seconds of a simulated run, where that is no more samples."""
PER_PERIOD = 12
"""Samples per period of the fastest motion that is proposed."""
BETWEEN = 1.0
"""Seconds between runs."""
SWING = 0.05
"""Part of a turn over which a shaft is swung to and fro: 18 deg."""
WARM = 5.0
"""Kelvin by which a temperature cycle goes up and down."""


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
    columns = (*model.references, *vertical, "temperature_degc")
    seen: dict[str, list[np.ndarray]] = {}
    slopes: dict[str, list[np.ndarray]] = {}
    step, first, last = [], None, 0.0
    for piece in pieces(base, frozenset(base.log.runs)):
        thin = slice(None, None, max(1, len(piece.t) // 256))
        for c in columns:
            if c in piece.data:
                seen.setdefault(c, []).append(piece.data[c][thin])
        for c in model.references:
            slopes.setdefault(c, []).append(piece.data[f"d1_{c}"][thin])
        step.append(float(np.median(np.diff(piece.t))) if len(piece.t) > 1 else np.nan)
        first = float(piece.t[0]) if first is None else first
        last = float(piece.t[-1])
    values = {c: np.concatenate(v) for c, v in seen.items()}
    half, middle = {}, {}
    for c, v in values.items():
        low, high = np.quantile(v, [0.005, 0.995])
        half[c], middle[c] = float(high - low) / 2, float(high + low) / 2
    typical = [
        float(np.std(np.concatenate(slopes[c])) / np.std(values[c])) / (2 * np.pi)
        for c in model.references
        if np.std(values[c]) > 0
    ]
    names = dict(zip(model.references, model.pose, strict=True))
    return Range(
        model.pose, vertical, {names.get(c, c): v for c, v in half.items()},
        {names.get(c, c): v for c, v in middle.items()}, max(typical, default=1.0),
        float(np.nanmin(step) if turn else np.nanmedian(step)),
        first or 0.0, last, middle.get("temperature_degc"),
        float(np.quantile(np.abs(np.concatenate(slopes[model.references[0]])), 0.95)),
        turn,
        model.family.noun or model.family.name,
    )  # fmt: skip


def recordings(r: Range) -> list[Recording]:
    """Return what could be recorded, from the plain to the elaborate."""
    return _turns(r) if r.turn and r.speed > 0 else _strokes(r)


def _turns(r: Range) -> list[Recording]:
    """What a shaft can do: turn at a speed, both ways, swing, rest, or turn while it gets warm."""
    seconds = min(LENGTH, LONGEST * r.step_s)
    fastest = r.turn / (2 * PER_PERIOD * r.step_s)
    v = min(r.speed, fastest)
    out: list[Recording] = []

    def add(text: str, *legs: tuple[float, float], temperature: AtTimes | None = None) -> None:
        """A run of legs (share of the time, speed)."""
        out.append(Recording(f"{text} ({seconds:.3g} s)", Run(seconds, {}, {r.pose[0]: _legs(legs, seconds)}),
                             temperature))  # fmt: skip

    def both_ways(speed: float) -> tuple[tuple[float, float], ...]:
        return (0.5, speed), (0.5, -speed)

    whole = 2.0 * r.turn / seconds  # a turn each way
    for times in (1.0, 2.0, 4.0, 8.0):
        if times * v <= fastest:
            add(f"turns in both directions at {_speed(times * v, r.turn)}", *both_ways(times * v))
    if v > 4 * whole:
        add(f"turns in both directions, slowly, at {_speed(v / 4, r.turn)}", *both_ways(v / 4))
    steps = [s * v for s in (0.25, 0.5, 1.0, 2.0, 4.0) if s * v <= fastest]
    add(f"turns in both directions at {len(steps)} speeds, up to {_speed(steps[-1], r.turn)}",
        *((0.5 / len(steps), s) for s in (*steps, *(-s for s in reversed(steps)))))  # fmt: skip
    add(f"turns in one direction at {_speed(v, r.turn)}", (1.0, v))
    swing = min(v, SWING * r.turn / (2 * PER_PERIOD * r.step_s))  # each way long enough to be seen
    shuttles = round(swing * seconds / (2 * SWING * r.turn))
    if shuttles > 1:
        reach = swing * seconds / (2 * shuttles) * 360 / r.turn
        add(
            f"swings to and fro over {reach:.2g} deg at {_speed(swing, r.turn)}", *both_ways(swing) * shuttles
        )
    add(f"the {r.noun} at rest", (1.0, 0.0))
    if r.temperature is not None:
        middle = r.temperature
        add(f"turns in both directions at {_speed(v, r.turn)} through a temperature cycle of +-{WARM:g} K",
            *both_ways(v), temperature=lambda t: middle + WARM * np.sin(2 * np.pi * t / seconds))  # fmt: skip
    return out


def _legs(legs: Sequence[tuple[float, float]], seconds: float) -> AtTimes:
    """Return the place over time of legs (share of the time, speed), one after the other."""
    share = np.array([a for a, _ in legs]) / sum(a for a, _ in legs)
    ends = np.concatenate([[0.0], np.cumsum(share * seconds)])
    places = np.concatenate([[0.0], np.cumsum(share * seconds * np.array([v for _, v in legs]))])
    return lambda t: np.interp(t, ends, places)


def _speed(value: float, turn: float) -> str:
    return f"{float(f'{60 * value / turn:.3g}'):g} rpm"


def _strokes(r: Range) -> list[Recording]:
    """What a machine of limited travel can do."""
    fastest = 1.0 / (PER_PERIOD * r.step_s)
    seconds = min(LENGTH, LONGEST * r.step_s)
    f = min(max(r.frequency_hz, 2.0 / seconds), fastest)
    out: list[Recording] = []

    def add(text: str, motion: dict[str, AtTimes], setting: dict[str, float] | None = None,
            temperature: AtTimes | None = None) -> None:  # fmt: skip
        away = [c for c in r.pose if abs(r.centre[c]) > r.amplitude[c]]  # a gap never comes to 0
        level = {c: r.centre[c] for c in (*r.vertical, *away)} | (setting or {})
        out.append(Recording(f"{text} ({seconds:.3g} s)", Run(seconds, level, motion), temperature))

    all_axes = _names(r.pose)
    for times in (1.0, 2.0, 4.0, 8.0):
        if times * f <= fastest:
            add(f"{all_axes} together at {_hz(times * f)}", _sines(r, times * f))
    if f > 8.0 / seconds:
        add(f"{all_axes} together, slowly, at {_hz(f / 4)}", _sines(r, f / 4))
    add(f"{all_axes} together over a fifth of the stroke at {_hz(f)}", _sines(r, f, 0.2))
    tones = [x for x in f * np.array([0.5, 1.0, 2.0, 4.0, 8.0]) if x <= fastest]
    add(
        f"{all_axes} with {len(tones)} frequencies at once, up to {_hz(tones[-1])}",
        {c: multi_sine(2 * r.amplitude[c], [x * s for x in tones]) for c, s in _spread(r.pose)},
    )
    add(f"{all_axes} at constant speed to and fro, at {_hz(f)}",
        {c: _to_and_fro(r.amplitude[c], f * s) for c, s in _spread(r.pose)})  # fmt: skip
    for c in r.pose:
        add(f"{_names((c,))} alone at {_hz(f)}", {c: sine(r.amplitude[c], f)})
    add("everything at rest", {})
    for c in r.vertical:
        if r.amplitude[c] > 0:
            add(f"{_names((c,))} moved within the run while {all_axes} stand still",
                {c: sine(r.amplitude[c], 2.0 / seconds)})  # fmt: skip
    if all(r.amplitude[c] > 0 for c in r.vertical) and r.vertical:
        slow = {c: sine(r.amplitude[c], (2.0 + k) / seconds) for k, c in enumerate(r.vertical)}
        add(f"{_names(r.vertical)} moved within the run while {all_axes} move at {_hz(f)}",
            {**_sines(r, f), **slow})  # fmt: skip
    if r.temperature is not None:
        middle = r.temperature
        add(f"{all_axes} at {_hz(f)} through a temperature cycle of +-{WARM:g} K", _sines(r, f), None,
            lambda t: middle + WARM * np.sin(2 * np.pi * t / seconds))  # fmt: skip
    return out


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
