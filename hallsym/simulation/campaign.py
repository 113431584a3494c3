"""A campaign: which runs are recorded, at which vertical settings, along which trajectories.

A campaign is a TOML file (docs/campaign.md), or the paper's (`hallsym.simulation.paper`). A signal is a
function of time that knows how a campaign file describes it, so a campaign that was made here can be written.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError
from hallsym.families import axes
from hallsym.files import atomic_write
from hallsym.toml import Table, number, positive

AtTimes = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Signal:
    """A position over time, `signal(t)` with t in s, and how a campaign file describes it.

    `kind` and `values` are what the file holds; two signals are equal when these are.
    """

    kind: str
    values: Mapping[str, Any]
    at: AtTimes = field(compare=False, repr=False)

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Return the position at times `t` [s]."""
        return self.at(t)


@dataclass(frozen=True, eq=False)
class Run:
    """One run: duration [s], position of each moving axis as a function of time since the reset [s].

    Any function of time can be a motion; only a `Signal` can be written to a file.
    """

    duration_s: float
    setting: Mapping[str, float]
    motion: Mapping[str, AtTimes]
    zeros: tuple[float, ...] | None = None
    """Zero deviations delta [m] of this run; None: drawn at random."""
    name: str = ""

    def position(self, axis: str, t: np.ndarray) -> np.ndarray:
        """Return `axis` at times `t`: its setting plus its motion."""
        still = np.full(len(t), self.setting.get(axis, 0.0))
        return still + self.motion[axis](t) if axis in self.motion else still


@dataclass(frozen=True, eq=False)
class Campaign:
    """Runs on one clock. `noise`: standard deviation per column as the file states it, may be empty."""

    step_s: float
    runs: tuple[Run, ...]
    zero_spread_m: float = 1e-6
    noise: Mapping[str, float] | None = None

    @property
    def rows(self) -> int:
        """Samples over all runs."""
        return sum(self.samples(run) for run in self.runs)

    def samples(self, run: Run) -> int:
        """Samples of one run."""
        return max(1, round(run.duration_s / self.step_s))


# -- signals ---------------------------------------------------------------------------------------------


def sine(amplitude: float, frequency_hz: float, phase_rad: float = 0.0) -> Signal:
    """Return amplitude * sin(2 pi f t + phase)."""
    values = {"amplitude": amplitude, "frequency_hz": frequency_hz}
    if phase_rad:
        values["phase_rad"] = phase_rad
    return Signal("sine", values, lambda t: amplitude * np.sin(2 * pi * frequency_hz * t + phase_rad))


def multi_sine(amplitude: float, frequencies_hz: list[float]) -> Signal:
    """Return a sum of equal sines with Schroeder phases, its peak at most `amplitude`."""
    n = len(frequencies_hz)
    if n == 0:
        raise InputError("'frequencies_hz' of a multi-sine must hold at least one frequency; it is empty.")
    phases = [-pi * k * (k + 1) / n for k in range(n)]
    start = sum(np.sin(phase) for phase in phases)

    def at(t: np.ndarray) -> np.ndarray:
        waves = (np.sin(2 * pi * f * t + p) for f, p in zip(frequencies_hz, phases, strict=True))
        return amplitude / (2 * n) * (sum(waves, np.zeros(len(t))) - start)

    return Signal("multi-sine", {"amplitude": amplitude, "frequencies_hz": list(frequencies_hz)}, at)


def triangle(amplitude: float, frequency_hz: float) -> Signal:
    """Return a triangle of the given amplitude that starts at 0 and rises: the lines of a raster."""
    values = {"amplitude": amplitude, "frequency_hz": frequency_hz}
    return Signal(
        "triangle", values, lambda t: amplitude * (1 - 4 * np.abs(np.mod(frequency_hz * t + 0.25, 1.0) - 0.5))
    )


def steps(levels: list[float], dwell_s: float) -> Signal:
    """Return `levels` in turn, each held for `dwell_s`, from the beginning again after the last."""
    if not levels:
        raise InputError("'levels' of steps must hold at least one level; it is empty.")
    held = np.asarray(levels, dtype=float)
    values = {"levels": held.tolist(), "dwell_s": dwell_s}
    return Signal("steps", values, lambda t: held[np.floor(t / dwell_s + 1e-9).astype(int) % len(held)])


def ramp(rate: float, acceleration: float = 0.0) -> Signal:
    """Return rate * t + acceleration * t^2 / 2: turning at a constant or a growing speed."""
    values = {"rate": rate} | ({"acceleration": acceleration} if acceleration else {})
    return Signal("ramp", values, lambda t: rate * t + 0.5 * acceleration * t**2)


KEYS = ("step_s", "zero_spread_m", "setting", "trajectory", "run", "noise")
"""Keys of a campaign file."""
SIGNALS: Mapping[str, tuple[Callable[..., Signal], tuple[str, ...], tuple[str, ...]]] = {
    "sine": (sine, ("amplitude", "frequency_hz"), ("phase_rad",)),
    "multi-sine": (multi_sine, ("amplitude", "frequencies_hz"), ()),
    "triangle": (triangle, ("amplitude", "frequency_hz"), ()),
    "steps": (steps, ("levels", "dwell_s"), ()),
    "ramp": (ramp, ("rate",), ("acceleration",)),
}


# -- campaign files --------------------------------------------------------------------------------------


def read_campaign(path: str | Path) -> Campaign:
    """Read a campaign from TOML: a clock, trajectories run at each vertical setting, then single runs.

    Raises `InputError` for a missing file, an unknown key or signal, or a value that cannot be.
    """
    return _campaign(Table.read(path, "Campaign file", KEYS))


def campaign_from(raw: Mapping[str, Any], where: str) -> Campaign:
    """Return the campaign that the tables of a campaign file describe; `where` is what messages call it."""
    return _campaign(Table(raw, where, KEYS))


def _campaign(file: Table) -> Campaign:
    settings = [{axis: at.number(axis) for axis in at.raw} for at in file.tables("setting", axes())]
    trajectories = file.tables("trajectory", ("duration_s", "raster", *axes()))
    single = file.tables("run", ("name", "duration_s", "zero_deviations_m", "raster", *axes()))
    if not trajectories and ("setting" in file or not single):
        instead = "" if "setting" in file else " or [[run]]"
        raise InputError(f"In {file.where} at least one [[trajectory]]{instead} is needed; there is none.")
    if "setting" not in file:
        settings = [{}]
    product = (_run(setting, entry) for setting in settings for entry in trajectories)
    return Campaign(
        file.positive("step_s", 2e-3),
        (*product, *map(_single, single)),
        file.number("zero_spread_m", 1e-6, least=0.0),
        noise_table(file),
    )


def noise_table(file: Table) -> dict[str, float]:
    """Return the `[noise]` table of a file: 1 sigma by column, in the unit that the key states."""
    noise = file.table("noise", where=f"noise in {file.where}")
    return {column: noise.positive(column) for column in noise.raw}


def _run(setting: Mapping[str, float], entry: Table) -> Run:
    motion = {axis: _signal(entry, axis) for axis in axes() if axis in entry}
    return Run(entry.positive("duration_s"), setting, motion | _raster(entry, motion))


def _single(entry: Table) -> Run:
    """A [[run]]: each axis held at a number or moved by a signal, about a place of its own."""
    setting: dict[str, float] = {}
    motion: dict[str, Signal] = {}
    name = entry.raw.get("name", "")
    if not isinstance(name, str):
        raise InputError(f"'name' of {entry.where} must be a text; instead received {name!r}.")
    for axis in (axis for axis in axes() if axis in entry):
        if isinstance(entry.raw[axis], Mapping):
            motion[axis] = _signal(entry, axis, setting)
        else:
            setting[axis] = entry.number(axis)
    zeros = tuple(entry.numbers("zero_deviations_m")) if "zero_deviations_m" in entry else None
    motion |= _raster(entry, motion)
    return Run(entry.positive("duration_s"), setting, motion, zeros, name)


def _raster(entry: Table, motion: Mapping[str, Signal]) -> dict[str, Signal]:
    """`{fast="x_m", slow="y_m", fast_amplitude=, slow_amplitude=, line_hz=, lines=}`; {} without one."""
    if "raster" not in entry:
        return {}
    keys = ("fast", "slow", "fast_amplitude", "slow_amplitude", "line_hz", "lines")
    raster = entry.table("raster", keys, f"raster in {entry.where}")
    missing = [k for k in keys if k not in raster]
    if missing:
        raise InputError(f"A {raster.where} needs {', '.join(keys)}; missing {missing[0]}.")
    fast, slow = raster.raw["fast"], raster.raw["slow"]
    if fast not in axes() or slow not in axes() or fast == slow:
        raise InputError(
            f"'fast' and 'slow' of {raster.where} must be two of {', '.join(axes())}; instead received "
            f"{fast!r}, {slow!r}."
        )
    line_hz, lines = raster.positive("line_hz"), raster.positive("lines")
    found = {
        fast: triangle(raster.number("fast_amplitude"), line_hz),
        slow: triangle(raster.number("slow_amplitude"), line_hz / lines),
    }
    twice = [axis for axis in found if axis in motion]
    if twice:
        raise InputError(
            f"Axis {twice[0]} of {entry.where} is moved by its own signal and by the raster; keep one."
        )
    return found


def _signal(entry: Table, axis: str, setting: dict[str, float] | None = None) -> Signal:
    """Read the signal of an axis; its place `about` goes into `setting`, and is unknown without one."""
    raw = entry.raw[axis]
    signal = Table(raw if isinstance(raw, Mapping) else {"kind": "none"}, f"{axis} in {entry.where}")
    kind = signal.choice("kind", list(SIGNALS), "none")
    make, required, optional = SIGNALS[kind]
    about = () if setting is None else ("about",)
    signal = Table(signal.raw, signal.where, ("kind", *required, *optional, *about))
    missing = [k for k in required if k not in signal]
    if missing:
        raise InputError(
            f"Signal {kind!r} of {signal.where} needs {', '.join(required)}; missing {missing[0]}."
        )
    if setting is not None and "about" in signal:
        setting[axis] = signal.number("about")
    return make(**{k: _value(signal, k) for k in (*required, *optional) if k in signal})


def _value(signal: Table, key: str) -> float | list[float]:
    """One number of a signal, or a list of them; frequencies and dwell times are positive."""
    check = positive if key in ("frequency_hz", "frequencies_hz", "dwell_s") else number
    if key in ("frequencies_hz", "levels"):
        return signal.numbers(key, check)
    return check(signal.raw[key], key, signal.where)


# -- writing ---------------------------------------------------------------------------------------------


def write_campaign(campaign: Campaign, path: str | Path, comment: str = "") -> None:
    """Write a campaign as TOML, one [[run]] each; `read_campaign` gives the same runs back.

    `comment`: text for the head of the file. Raises `InputError` for a motion that is not a `Signal`.
    """
    head = [f"# {line}".rstrip() for line in comment.splitlines()]
    head += [f"step_s = {float(campaign.step_s)!r}", f"zero_spread_m = {float(campaign.zero_spread_m)!r}"]
    if campaign.noise:
        head += ["", "[noise]", *(f"{_key(k)} = {float(v)!r}" for k, v in campaign.noise.items())]
    for k, run in enumerate(campaign.runs):
        head += ["", "[[run]]", *_run_lines(run, k)]
    atomic_write(path, "\n".join(head) + "\n")


def _run_lines(run: Run, k: int) -> list[str]:
    lines = [f"name = {_text(run.name)}"] if run.name else []
    lines.append(f"duration_s = {float(run.duration_s)!r}")
    if run.zeros:
        lines.append(f"zero_deviations_m = {_plain(run.zeros)}")
    for axis in axes():
        place = run.setting.get(axis)
        if axis in run.motion:
            lines.append(f"{axis} = {_signal_text(run.motion[axis], place, f'{axis} in run {k}')}")
        elif place is not None:
            lines.append(f"{axis} = {float(place)!r}")
    return lines


def _signal_text(signal: AtTimes, about: float | None, where: str) -> str:
    if not isinstance(signal, Signal):
        raise InputError(
            f"The motion of {where} is a plain function, which a file cannot hold; use one of "
            f"{', '.join(SIGNALS)} of hallsym.simulation."
        )
    place = {} if about is None else {"about": about}
    entries = ", ".join(f"{k} = {_plain(v)}" for k, v in (place | dict(signal.values)).items())
    return f"{{ kind = {_text(signal.kind)}, {entries} }}"


def _plain(value: float | Sequence[float]) -> str:
    if isinstance(value, Sequence):
        return f"[{', '.join(repr(float(v)) for v in value)}]"
    return repr(float(value))


def _key(name: str) -> str:
    return name if name.replace("_", "").isalnum() and name.isascii() else _text(name)


def _text(text: str) -> str:
    """A TOML basic string: JSON's, which leaves DEL as it is."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
