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

from hallsym.errors import InputError, nearest
from hallsym.families import axes
from hallsym.files import atomic_write
from hallsym.toml import known, number, numbers, positive, read_toml, table, tables

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
    path = Path(path)
    return campaign_from(read_toml(path, "Campaign file"), f"campaign {path.name}")


def campaign_from(raw: Mapping[str, Any], where: str) -> Campaign:
    """Return the campaign that the tables of a campaign file describe; `where` is what messages call it."""
    known(raw, ("step_s", "zero_spread_m", "setting", "trajectory", "run", "noise"), where)
    settings = [_setting(entry, where) for entry in tables(raw.get("setting", [{}]), "setting", where)]
    trajectories = tables(raw.get("trajectory", []), "trajectory", where)
    single = tables(raw.get("run", []), "run", where)
    if not trajectories and ("setting" in raw or not single):
        instead = "" if "setting" in raw else " or [[run]]"
        raise InputError(f"In {where} at least one [[trajectory]]{instead} is needed; there is none.")
    product = tuple(_run(setting, entry, where) for setting in settings for entry in trajectories)
    return Campaign(
        positive(raw.get("step_s", 2e-3), "step_s", where),
        product + tuple(_single(entry, where) for entry in single),
        number(raw.get("zero_spread_m", 1e-6), "zero_spread_m", where, least=0.0),
        noise_table(raw, where),
    )


def noise_table(raw: Mapping[str, Any], where: str) -> dict[str, float]:
    """Return the `[noise]` table of a file: 1 sigma by column, in the unit that the key states."""
    return {
        k: positive(v, k, f"noise in {where}") for k, v in table(raw.get("noise", {}), "noise", where).items()
    }


def _setting(raw: Mapping[str, Any], where: str) -> dict[str, float]:
    known(raw, axes(), f"a [[setting]] of {where}")
    return {axis: number(value, axis, f"a [[setting]] of {where}") for axis, value in raw.items()}


def _run(setting: Mapping[str, float], entry: Mapping[str, Any], where: str) -> Run:
    where = f"a [[trajectory]] of {where}"
    known(entry, ("duration_s", "raster", *axes()), where)
    motion = {axis: _signal(entry[axis], f"{axis} in {where}") for axis in axes() if axis in entry}
    motion = _with_raster(entry, motion, where)
    return Run(positive(entry.get("duration_s"), "duration_s", where), setting, motion)


def _single(entry: Mapping[str, Any], where: str) -> Run:
    """A [[run]]: each axis held at a number or moved by a signal, about a place of its own."""
    where = f"a [[run]] of {where}"
    known(entry, ("name", "duration_s", "zero_deviations_m", "raster", *axes()), where)
    name, zeros = entry.get("name", ""), entry.get("zero_deviations_m")
    if not isinstance(name, str):
        raise InputError(f"'name' of {where} must be a text; instead received {name!r}.")
    setting, motion = {}, {}
    for axis in (axis for axis in axes() if axis in entry):
        raw, what = entry[axis], f"{axis} in {where}"
        if not isinstance(raw, Mapping):
            setting[axis] = number(raw, axis, where)
            continue
        if "about" in raw:
            setting[axis] = number(raw["about"], "about", what)
        motion[axis] = _signal({k: v for k, v in raw.items() if k != "about"}, what)
    motion = _with_raster(entry, motion, where)
    return Run(
        positive(entry.get("duration_s"), "duration_s", where),
        setting,
        motion,
        None if zeros is None else tuple(numbers(zeros, "zero_deviations_m", where)),
        name,
    )


def _with_raster(entry: Mapping[str, Any], motion: dict[str, Signal], where: str) -> dict[str, Signal]:
    if "raster" in entry:
        raster = _raster(table(entry["raster"], "raster", where), f"raster in {where}")
        twice = [axis for axis in raster if axis in motion]
        if twice:
            raise InputError(
                f"Axis {twice[0]} of {where} is moved by its own signal and by the raster; keep one."
            )
        motion = motion | raster
    return motion


def _raster(raw: Mapping[str, Any], where: str) -> dict[str, Signal]:
    """`{fast="x_m", slow="y_m", fast_amplitude=, slow_amplitude=, line_hz=, lines=}`."""
    keys = ("fast", "slow", "fast_amplitude", "slow_amplitude", "line_hz", "lines")
    known(raw, keys, where)
    missing = [k for k in keys if k not in raw]
    if missing:
        raise InputError(f"A {where} needs {', '.join(keys)}; missing {missing[0]}.")
    fast, slow = raw["fast"], raw["slow"]
    if fast not in axes() or slow not in axes() or fast == slow:
        known_axes = ", ".join(axes())
        raise InputError(
            f"'fast' and 'slow' of {where} must be two of {known_axes}; instead received {fast!r}, {slow!r}."
        )
    line_hz, lines = (positive(raw[k], k, where) for k in ("line_hz", "lines"))
    wide, high = (number(raw[k], k, where) for k in ("fast_amplitude", "slow_amplitude"))
    return {fast: triangle(wide, line_hz), slow: triangle(high, line_hz / lines)}


def _signal(raw: Any, where: str) -> Signal:
    kind = str(raw.get("kind")) if isinstance(raw, Mapping) else "none"
    if kind not in SIGNALS:
        raise InputError(
            f"'kind' of {where} must be one of {', '.join(SIGNALS)}; instead received {kind!r}"
            f"{nearest(kind, list(SIGNALS))}."
        )
    make, required, optional = SIGNALS[kind]
    known(raw, ("kind", *required, *optional), where)
    missing = [k for k in required if k not in raw]
    if missing:
        raise InputError(f"Signal {kind!r} of {where} needs {', '.join(required)}; missing {missing[0]}.")
    return make(**{k: _value(raw[k], k, where) for k in (*required, *optional) if k in raw})


def _value(value: Any, key: str, where: str) -> float | list[float]:
    """One number of a signal, or a list of them; frequencies and dwell times are positive."""
    check = positive if key in ("frequency_hz", "frequencies_hz", "dwell_s") else number
    return (
        numbers(value, key, where, check) if key in ("frequencies_hz", "levels") else check(value, key, where)
    )


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
