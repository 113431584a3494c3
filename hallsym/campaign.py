"""A campaign: which runs are recorded, at which vertical settings, along which trajectories.

The paper's campaign is `paper_campaign()`; any other is a TOML file (docs/campaign.md).
"""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from hallsym import published
from hallsym.errors import InputError, nearest
from hallsym.files import reason

AXES = ("x_m", "y_m", "rz_rad", "z_m", "rx_rad", "ry_rad")
Signal = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Run:
    """One run: duration [s], position of each moving axis as a function of time since the reset [s]."""

    duration_s: float
    setting: Mapping[str, float]
    motion: Mapping[str, Signal]
    zeros: tuple[float, ...] | None = None
    """Zero deviations delta [m] of this run; None: drawn at random."""

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
    return lambda t: amplitude * np.sin(2 * pi * frequency_hz * t + phase_rad)


def multi_sine(amplitude: float, frequencies_hz: list[float]) -> Signal:
    """Return a sum of equal sines with Schroeder phases, its peak at most `amplitude`."""
    n = len(frequencies_hz)
    if n == 0:
        raise InputError("'frequencies_hz' of a multi-sine must hold at least one frequency; it is empty.")
    phases = [-pi * k * (k + 1) / n for k in range(n)]
    start = sum(np.sin(phase) for phase in phases)

    def signal(t: np.ndarray) -> np.ndarray:
        waves = (np.sin(2 * pi * f * t + p) for f, p in zip(frequencies_hz, phases, strict=True))
        return amplitude / (2 * n) * (sum(waves, np.zeros(len(t))) - start)

    return signal


def triangle(amplitude: float, frequency_hz: float) -> Signal:
    """Return a triangle of the given amplitude that starts at 0 and rises: the lines of a raster."""
    return lambda t: amplitude * (1 - 4 * np.abs(np.mod(frequency_hz * t + 0.25, 1.0) - 0.5))


def steps(levels: list[float], dwell_s: float) -> Signal:
    """Return `levels` in turn, each held for `dwell_s`, from the beginning again after the last."""
    if not levels:
        raise InputError("'levels' of steps must hold at least one level; it is empty.")
    held = np.asarray(levels, dtype=float)
    return lambda t: held[np.floor(t / dwell_s + 1e-9).astype(int) % len(held)]


SIGNALS: Mapping[str, tuple[Callable[..., Signal], tuple[str, ...], tuple[str, ...]]] = {
    "sine": (sine, ("amplitude", "frequency_hz"), ("phase_rad",)),
    "multi-sine": (multi_sine, ("amplitude", "frequencies_hz"), ()),
    "triangle": (triangle, ("amplitude", "frequency_hz"), ()),
    "steps": (steps, ("levels", "dwell_s"), ()),
}


# -- the paper's campaign --------------------------------------------------------------------------------


def paper_campaign(step_s: float = 2e-3, duration_s: float = 1.0) -> Campaign:
    """Return Table 6's 19 vertical settings, each with sines on Y, X and Rz, and Table A1's deviations.

    Sines of 500 um, 300 um and 300 urad at 1 Hz on a 2 ms clock (Section 5 of the paper). Runs are numbered
    from 0 in the order of Table A1: setting by setting, Y then X then Rz.
    """
    settings, deviations = published.table("table6_settings"), published.table("tableA1_zero_deviations")
    motions = {
        "y": {"y_m": sine(500e-6, 1.0)},
        "x": {"x_m": sine(300e-6, 1.0)},
        "rz": {"rz_rad": sine(300e-6, 1.0)},
    }
    vertical = {
        number: {axis: settings[axis][k] for axis in ("z_m", "rx_rad", "ry_rad")}
        for k, number in enumerate(settings["setting"])
    }
    runs = tuple(
        Run(duration_s, vertical[setting], motions[axis], (a, b, c))
        for setting, axis, a, b, c in zip(
            *(deviations[n] for n in ("setting", "axis", "delta_a_m", "delta_b_m", "delta_c_m")), strict=True
        )
    )
    return Campaign(step_s, runs)


# -- campaign files --------------------------------------------------------------------------------------


def read_campaign(path: str | Path) -> Campaign:
    """Read a campaign from TOML: a clock, vertical settings, and trajectories run at each of them.

    Raises `InputError` for a missing file, an unknown key or signal, or a value that cannot be.
    """
    path = Path(path)
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"Campaign file {path} does not exist; give the path of a TOML file.") from None
    except OSError as error:
        raise InputError(f"Campaign file {path} cannot be read: {reason(error)}.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"Campaign file {path} is not valid TOML: {' '.join(str(error).split())}.") from None
    where = f"campaign {path.name}"
    _known(raw, ("step_s", "zero_spread_m", "setting", "trajectory", "noise"), where)
    settings = [_setting(entry, where) for entry in _tables(raw.get("setting", [{}]), "setting", where)]
    trajectories = _tables(raw.get("trajectory", []), "trajectory", where)
    if not trajectories:
        raise InputError(f"In {where} at least one [[trajectory]] is needed; there is none.")
    return Campaign(
        _positive(raw.get("step_s", 2e-3), "step_s", where),
        tuple(_run(setting, entry, where) for setting in settings for entry in trajectories),
        _number(raw.get("zero_spread_m", 1e-6), "zero_spread_m", where, least=0.0),
        {
            k: _positive(v, k, f"noise in {where}")
            for k, v in _table(raw.get("noise", {}), "noise", where).items()
        },
    )


def _tables(raw: Any, key: str, where: str) -> list[Mapping[str, Any]]:
    if not isinstance(raw, list) or not all(isinstance(entry, Mapping) for entry in raw):
        raise InputError(f"In {where}, {key} must be [[{key}]] tables; instead received {raw!r}.")
    return raw


def _table(raw: Any, key: str, where: str) -> Mapping[str, Any]:
    if not isinstance(raw, Mapping):
        raise InputError(f"In {where}, {key} must be a table; instead received {raw!r}.")
    return raw


def _setting(raw: Mapping[str, Any], where: str) -> dict[str, float]:
    _known(raw, AXES, f"a [[setting]] of {where}")
    return {axis: _number(value, axis, f"a [[setting]] of {where}") for axis, value in raw.items()}


def _run(setting: Mapping[str, float], entry: Mapping[str, Any], where: str) -> Run:
    where = f"a [[trajectory]] of {where}"
    _known(entry, ("duration_s", "raster", *AXES), where)
    motion = {axis: _signal(entry[axis], f"{axis} in {where}") for axis in AXES if axis in entry}
    if "raster" in entry:
        raster = _raster(_table(entry["raster"], "raster", where), f"raster in {where}")
        twice = [axis for axis in raster if axis in motion]
        if twice:
            raise InputError(
                f"Axis {twice[0]} of {where} is moved by its own signal and by the raster; keep one."
            )
        motion |= raster
    return Run(_positive(entry.get("duration_s"), "duration_s", where), setting, motion)


def _raster(raw: Mapping[str, Any], where: str) -> dict[str, Signal]:
    """`{fast="x_m", slow="y_m", fast_amplitude=, slow_amplitude=, line_hz=, lines=}`."""
    keys = ("fast", "slow", "fast_amplitude", "slow_amplitude", "line_hz", "lines")
    _known(raw, keys, where)
    missing = [k for k in keys if k not in raw]
    if missing:
        raise InputError(f"A {where} needs {', '.join(keys)}; missing {missing[0]}.")
    fast, slow = raw["fast"], raw["slow"]
    if fast not in AXES or slow not in AXES or fast == slow:
        axes = ", ".join(AXES)
        raise InputError(
            f"'fast' and 'slow' of {where} must be two of {axes}; instead received {fast!r}, {slow!r}."
        )
    line_hz, lines = (_positive(raw[k], k, where) for k in ("line_hz", "lines"))
    wide, high = (_number(raw[k], k, where) for k in ("fast_amplitude", "slow_amplitude"))
    return {fast: triangle(wide, line_hz), slow: triangle(high, line_hz / lines)}


def _signal(raw: Any, where: str) -> Signal:
    kind = str(raw.get("kind")) if isinstance(raw, Mapping) else "none"
    if kind not in SIGNALS:
        raise InputError(
            f"'kind' of {where} must be one of {', '.join(SIGNALS)}; instead received {kind!r}"
            f"{nearest(kind, list(SIGNALS))}."
        )
    make, required, optional = SIGNALS[kind]
    _known(raw, ("kind", *required, *optional), where)
    missing = [k for k in required if k not in raw]
    if missing:
        raise InputError(f"Signal {kind!r} of {where} needs {', '.join(required)}; missing {missing[0]}.")
    return make(**{k: _value(raw[k], k, where) for k in (*required, *optional) if k in raw})


def _value(value: Any, key: str, where: str) -> float | list[float]:
    """One number of a signal, or a list of them; frequencies and dwell times are positive."""
    check = _positive if key in ("frequency_hz", "frequencies_hz", "dwell_s") else _number
    if key not in ("frequencies_hz", "levels"):
        return check(value, key, where)
    if not isinstance(value, list) or not value:
        raise InputError(f"'{key}' of {where} must be a list of numbers; instead received {value!r}.")
    return [check(entry, key, where) for entry in value]


def _known(raw: Mapping[str, Any], keys: tuple[str, ...], where: str) -> None:
    for key in raw:
        if key not in keys:
            raise InputError(
                f"Unknown key {key!r} in {where}{nearest(key, list(keys))}; known are {', '.join(keys)}."
            )


def _number(value: Any, key: str, where: str, least: float = -np.inf) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < np.inf:
        wanted = "a finite number" if least == -np.inf else f"a number >= {least:g}"
        raise InputError(f"'{key}' of {where} must be {wanted}; instead received {value!r}.")
    if value == -np.inf:
        raise InputError(f"'{key}' of {where} must be a finite number; instead received {value!r}.")
    return float(value)


def _positive(value: Any, key: str, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < np.inf:
        raise InputError(f"'{key}' of {where} must be a positive number; instead received {value!r}.")
    return float(value)
