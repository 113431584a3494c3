"""A campaign: its runs, vertical settings and trajectories.

A campaign is a TOML file (docs/campaign.md), or the paper's (`hallsym.simulation.paper`). A signal is a
function of time that carries its entry of a campaign file, so that a campaign can be written.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, require
from hallsym.families import axes
from hallsym.files import atomic_write
from hallsym.output import toml_text
from hallsym.simulation.signals import SIGNALS, AtTimes, Signal
from hallsym.toml import Table, number, positive
from hallsym.trajectory import Curve, read_curve
from hallsym.trajectory.export import at_times


@dataclass(frozen=True, eq=False)
class Run:
    """One run: duration [s], position of each moving axis as a function of time since the reset [s].

    Any function of time can be a motion; only a `Signal` can be written to a file.
    """

    duration_s: float
    setting: Mapping[str, float]
    motion: Mapping[str, AtTimes]
    offsets: tuple[float, ...] | None = None
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


MOST_SAMPLES = 20_000_000
"""Samples of a campaign file: 1.8 GB for the eleven columns of a log; 700 times the paper's campaign."""
MOST_RUNS = 10_000
"""Runs of a campaign file: half a year of recording, if a run takes half an hour."""
KEYS = ("step_s", "zero_spread_m", "setting", "trajectory", "run", "noise")
"""Keys of a campaign file."""


# -- campaign files --------------------------------------------------------------------------------------


def read_campaign(path: str | Path) -> Campaign:
    """Read a campaign from TOML: a clock, trajectories run at each vertical setting, then single runs.

    Raises `InputError` for a missing file, an unknown key or signal, or a value that cannot be.
    """
    return _campaign(Table.read(path, "Campaign file", KEYS), Path(path).parent)


def campaign_from(raw: Mapping[str, Any], where: str) -> Campaign:
    """Return the campaign that the tables of a campaign file describe; `where` is what messages call it."""
    return _campaign(Table(raw, where, KEYS), Path())


def _campaign(file: Table, folder: Path) -> Campaign:
    settings = [{axis: at.number(axis) for axis in at.raw} for at in file.tables("setting", axes())]
    trajectories = file.tables("trajectory", ("duration_s", "curve", *axes()))
    single = file.tables("run", ("name", "duration_s", "zero_deviations_m", "curve", *axes()))
    if not trajectories and ("setting" in file or not single):
        instead = "" if "setting" in file else " or [[run]]"
        raise InputError(f"In {file.where} at least one [[trajectory]]{instead} is needed; there is none.")
    if "setting" not in file:
        settings = [{}]
    count = len(settings) * len(trajectories) + len(single)
    require(count <= MOST_RUNS, f"Runs of a {file.where}", f"at most {MOST_RUNS} (leave settings out)", count)
    product = (_run(entry, folder, setting) for setting in settings for entry in trajectories)
    made = Campaign(
        file.positive("step_s", 2e-3),
        (*product, *(_run(entry, folder, {}, single=True) for entry in single)),
        file.number("zero_spread_m", 1e-6, least=0.0),
        noise_table(file),
    )
    samples = sum(run.duration_s for run in made.runs) / made.step_s
    wanted = f"at most {MOST_SAMPLES:g} (raise 'step_s' or shorten 'duration_s')"
    require(samples <= MOST_SAMPLES, f"Samples of a {file.where}", wanted, round(samples))
    return made


def noise_table(file: Table) -> dict[str, float]:
    """Return the `[noise]` table of a file: 1 sigma by column, in the unit that the key states."""
    noise = file.table("noise", where=f"noise in {file.where}")
    return {column: noise.positive(column) for column in noise.raw}


def _run(entry: Table, folder: Path, steady: Mapping[str, float], *, single: bool = False) -> Run:
    """A run with axes `steady` at a setting; a `single` one, [[run]], states its own settings and places."""
    setting, motion = dict(steady), {}
    name = entry.raw.get("name", "")
    require(isinstance(name, str), f"'name' of {entry.where}", "a text", name)
    for axis in (axis for axis in axes() if axis in entry):
        if single and not isinstance(entry.raw[axis], Mapping):
            setting[axis] = entry.number(axis)
        else:
            motion[axis] = _signal(entry, axis, setting if single else None)
    offsets = tuple(entry.numbers("zero_deviations_m")) if "zero_deviations_m" in entry else None
    motion |= _curve(entry, motion, folder)
    return Run(entry.positive("duration_s"), setting, motion, offsets, name)


def _curve(entry: Table, motion: Mapping[str, Signal], folder: Path) -> dict[str, Signal]:
    """`curve = "spiral.json"`, in the folder of the campaign file; {} without one."""
    if "curve" not in entry:
        return {}
    path = folder / entry.text("curve")
    curve = read_curve(path)
    beyond = [name for name in curve.coordinates if name not in axes()]
    if beyond:
        raise InputError(f"Curve {path} moves {beyond[0]}, which no run does; known are {', '.join(axes())}.")
    twice = [axis for axis in curve.coordinates if axis in motion]
    if twice:
        raise InputError(
            f"Axis {twice[0]} of {entry.where} is moved by its own signal and by the curve; keep one."
        )
    return follow(curve, entry.positive("duration_s"))


def follow(curve: Curve, duration_s: float) -> dict[str, Signal]:
    """Return the motion of a run of `duration_s` that follows a curve: `Run(2.0, {}, follow(curve, 2.0))`.

    The parameter of the curve runs evenly.
    """

    def along(axis: str) -> Signal:
        return Signal("curve", {}, lambda t: at_times(curve, t, duration_s)[axis], float("inf"))

    return {axis: along(axis) for axis in curve.coordinates}


def _signal(entry: Table, axis: str, setting: dict[str, float] | None = None) -> Signal:
    """Read the signal of an axis; its place `about` goes into `setting`, and is unknown without one."""
    raw = entry.raw[axis]
    signal = Table(raw if isinstance(raw, Mapping) else {"kind": "none"}, f"{axis} in {entry.where}")
    kind = signal.choice("kind", list(SIGNALS), "none")
    make, required, optional = SIGNALS[kind]
    about = () if setting is None else ("about",)
    signal = Table(signal.raw, signal.where, ("kind", *required, *optional, *about))
    given = [k for k in required if k in signal]
    require(
        len(given) == len(required),
        f"Signal {kind!r} of {signal.where}",
        f"with {', '.join(required)}",
        given,
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

    `comment`: text for the head of the file. Raises `InputError` for a motion that is not a `Signal`, or is a
    curve.
    """
    head = [f"# {line}".rstrip() for line in comment.splitlines()]
    head += [f"step_s = {float(campaign.step_s)!r}", f"zero_spread_m = {float(campaign.zero_spread_m)!r}"]
    if campaign.noise:
        head += ["", "[noise]", *_entries(campaign.noise)]
    for k, run in enumerate(campaign.runs):
        head += ["", "[[run]]", *_entries(_table(run, k))]
    atomic_write(path, "\n".join(head) + "\n")


def _table(run: Run, k: int) -> dict[str, Any]:
    """Return what a [[run]] holds."""
    own: dict[str, Any] = {"name": run.name} if run.name else {}
    own |= {"duration_s": run.duration_s} | ({"zero_deviations_m": run.offsets} if run.offsets else {})
    for axis in axes():
        signal, place = run.motion.get(axis), run.setting.get(axis)
        if signal is None:
            own |= {} if place is None else {axis: place}
        elif isinstance(signal, Signal) and signal.kind in SIGNALS:
            about = {} if place is None else {"about": place}
            own[axis] = {"kind": signal.kind, **about, **signal.values}
        else:
            raise InputError(
                f"The motion of {axis} in run {k} is a function or a curve, which is not written to a file; "
                f"use one of {', '.join(SIGNALS)} of hallsym.simulation."
            )
    return own


def _entries(table: Mapping[str, Any]) -> list[str]:
    """Return the entries of a table of TOML."""
    plain = {k: k.isascii() and k.replace("_", "").isalnum() for k in table}
    return [f"{k if plain[k] else toml_text(k)} = {_value_text(v)}" for k, v in table.items()]


def _value_text(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{ {', '.join(_entries(value))} }}"
    if isinstance(value, str):
        return toml_text(value)
    return f"[{', '.join(map(_value_text, value))}]" if isinstance(value, Sequence) else repr(float(value))
