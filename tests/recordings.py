"""Recordings of machines that are known: healthy ones of every family, and the same with one mistake in them.

`machine(family, seed)` draws a machine, its campaign and its noise and records a healthy log.
`mistaken(kind, family, seed)` makes one mistake of recording in such a log and says which corrections undo
it, in the words of `--correct`. `healthy(kind, seed)` records a log that holds no mistake although it is
short, slow, coarse, or of an odd machine. Everything is drawn by the seed; the physics is that of the models.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from operator import attrgetter
from zlib import crc32

import numpy as np
from scipy.signal import lfilter

from hallsym.families import build
from hallsym.families.halbach import planar
from hallsym.families.halbach.layout import Layout, Sensor, columns
from hallsym.families.stage.models import Probe, stage31
from hallsym.log import Log, Meta, Noise
from hallsym.simulation import Campaign, Run, simulate, sine
from hallsym.simulation.signals import AtTimes, ramp

Arrays = dict[str, np.ndarray]
FAMILIES = ("stage30", "stage31", "drawn", "rotary", "homed", "chip", "halbach", "planar")
"""`drawn`: stage31 with probes where a machine file puts them; `homed`: an encoder whose zero is another one
in each run; `chip`: an encoder that gives its angle; `planar`: four Halbach arrays over 12 sums."""
STAGES, ENCODERS, ARRAYS = FAMILIES[:3], FAMILIES[3:6], FAMILIES[6:]
TURN = 2 * np.pi


@dataclass(frozen=True, eq=False)
class Recording:
    """A log with what is known of it.

    `arrays`: its columns. `true`: the same without noise and without a mistake. `sigma`: the noise that was
    added; `stated`: what the log says of it. `effects`, `parameters`, `probes`: what a fit is told.
    """

    family: str
    model: str
    arrays: Arrays
    true: Arrays
    sigma: dict[str, float]
    stated: dict[str, float]
    effects: tuple[str, ...] = ()
    parameters: dict[str, dict[str, float]] = field(default_factory=dict)
    probes: list[dict] | None = None

    @property
    def log(self) -> Log:
        """The log as a fit takes it."""
        noise = Noise.given(self.stated, tuple(self.arrays))
        return Log.from_arrays(self.arrays, noise, Meta(base_model=self.model, probes=self.probes))

    @property
    def built(self):
        """The model that recorded it."""
        meta = Meta(probes=self.probes, columns=tuple(self.true))
        return build(self.model, meta=meta, added=self.effects, parameters=self.parameters)

    @property
    def readings(self) -> list[str]:
        return [c for c in self.built.channels if c in self.true]

    @property
    def references(self) -> list[str]:
        return list(self.built.references)

    @property
    def state(self) -> list[str]:
        return [c for c in self.built.state if c in self.true]

    @property
    def runs(self) -> np.ndarray:
        return np.unique(self.true["run"])

    def rows(self, run: int) -> slice:
        """Rows of a run."""
        at = np.flatnonzero(self.true["run"] == run)
        return slice(int(at[0]), int(at[-1]) + 1)


def kept(r: Recording, rows: np.ndarray) -> Recording:
    """Return the rows of a log in a mask."""
    return replace(r, arrays={c: x[rows] for c, x in r.arrays.items()},
                   true={c: x[rows] for c, x in r.true.items()})  # fmt: skip


def drawn_by(*what: object) -> np.random.Generator:
    """Return a generator that depends on all of these, in every process alike."""
    return np.random.default_rng([crc32(repr(w).encode()) for w in what])


# -- machines ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Plan:
    """A machine and what is recorded of it, before noise."""

    model: str
    values: dict[str, float]
    campaign: Campaign
    sigma: dict[str, float]
    effects: tuple[str, ...] = ()
    parameters: dict[str, dict[str, float]] = field(default_factory=dict)
    probes: list[dict] | None = None


@dataclass(frozen=True)
class Size:
    """How much is recorded: runs, samples of each, and the step of the clock [s]."""

    runs: int
    samples: int
    step_s: float


def size_of(family: str, rng: np.random.Generator) -> Size:
    """Draw 5 to 60 runs of 50 to 800 samples; fewer of a planar mover, whose fits are slow."""
    runs = int(np.exp(rng.uniform(np.log(5), np.log(61))))
    samples = int(np.exp(rng.uniform(np.log(60), np.log(801))))
    if family == "planar":
        runs, samples = int(rng.integers(5, 7)), int(rng.integers(40, 61))
    return Size(runs, min(samples, 12_000 // runs), float(10 ** rng.uniform(-3.3, -1.7)))


def machine(family: str, seed: object, size: Size | None = None) -> Recording:
    """Draw a machine and record a healthy log of it."""
    rng = drawn_by("machine", family, seed)
    drawn = size_of(family, rng)
    plan = PLANS[family](rng, size or drawn)
    return recorded(family, plan, rng, stated=rng.random() < 0.6, coloured=rng.random() < 0.15)


def recorded(
    family: str, plan: Plan, rng: np.random.Generator, *, stated: bool, coloured: bool = False
) -> Recording:
    """Record what is planned, with noise."""
    empty = Recording(family, plan.model, {}, {}, plan.sigma, plan.sigma if stated else {}, plan.effects,
                      plan.parameters, plan.probes)  # fmt: skip
    meta = Meta(probes=plan.probes, columns=tuple(plan.sigma))
    model = build(plan.model, meta=meta, added=plan.effects, parameters=plan.parameters)
    true = simulate(model, plan.values, plan.campaign, seed=int(rng.integers(2**31)))
    memory = float(np.exp(-1 / rng.uniform(1, 4))) if coloured else 0.0
    arrays = dict(true)
    for name, level in plan.sigma.items():
        noise = rng.standard_normal(len(true["run"]))
        if memory:
            noise = lfilter([np.sqrt(1 - memory**2)], [1, -memory], noise)
        arrays[name] = true[name] + level * noise
    if "angle_rad" in arrays:
        arrays["angle_rad"] = np.mod(arrays["angle_rad"], TURN)
    return replace(empty, arrays=arrays, true=true)


def _waves(amplitude: float, rng: np.random.Generator, size: Size) -> AtTimes:
    """One to four cycles in a run, with a phase, no period shorter than 25 samples."""
    seconds, most = size.samples * size.step_s, max(1.0, min(4.0, size.samples / 25))
    parts = [sine(amplitude * s, c / seconds, rng.uniform(0, TURN))
             for s, c in zip((0.6, 0.4), rng.uniform(0.7, most, 2), strict=True)]  # fmt: skip
    return lambda t: parts[0](t) + parts[1](t)


def _one_axis(amplitude: float, rng: np.random.Generator, size: Size) -> AtTimes:
    seconds = size.samples * size.step_s
    return sine(amplitude, float(rng.integers(1, 3)) / seconds)


def stage_plan(
    rng: np.random.Generator, size: Size, *, model: str = "stage31", probes: Sequence[Probe] = ()
) -> Plan:
    """Draw a stage inside its bounds; gains follow the height of each probe, as on a rigid stage, nearly."""
    layout = tuple(probes) or None
    built = stage31(layout) if layout else build("stage31")
    low, high = built.bounds
    values = {n: float(rng.uniform(0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b))
              for n, a, b in zip(built.names, low, high, strict=True)}  # fmt: skip
    at = np.array([rng.uniform(-0.05, 0.12), rng.uniform(-0.1, 0.1)])
    for probe in built.layout:
        label, (x, y) = probe.label, np.array(probe.position)
        values[f"theta_{label}"] = rng.uniform(-0.03, 0.03)
        a = -rng.uniform(60, 400)
        free = {f"a_{label}": a, f"b_{label}": a * (y - at[1]), f"c_{label}": -a * (x - at[0])}
        for name, value in free.items():
            i = built.names.index(name)
            values[name] = float(np.clip(value * rng.uniform(0.95, 1.05), low[i], high[i]))
    if model == "stage30":
        values = {n: v for n, v in values.items() if n[:2] not in ("a_", "b_", "c_")}
    travel = {"x_m": 3e-4, "y_m": 5e-4, "rz_rad": 3e-4}
    travel = {axis: a * rng.uniform(0.5, 1.5) for axis, a in travel.items()}
    level = float(10 ** rng.uniform(-7, -6))
    sigma = dict.fromkeys([p.channel for p in built.layout], level)
    sigma |= dict.fromkeys(built.references, level * rng.uniform(0.3, 1.5))
    sigma |= {"z_m": 12e-9, "rx_rad": 80e-9, "ry_rad": 80e-9}
    grid, slow = rng.random() < 0.4, rng.random() < 0.5
    runs = []
    for k in range(max(size.runs, 15) if grid else size.runs):
        state = {a: float(rng.uniform(-s, s)) for a, s in (("z_m", 3e-4), ("rx_rad", 4e-4), ("ry_rad", 4e-4))}
        axes = [list(travel)[k % 3]] if grid else list(travel)
        motion = {axis: (_one_axis if grid else _waves)(travel[axis], rng, size) for axis in axes}
        if slow and not grid:
            motion |= {c: _waves(0.3 * abs(v) + 2e-5, rng, size) for c, v in state.items()}
        runs.append(Run(size.samples * size.step_s, state, motion))
    entries = [p.entry for p in layout] if layout else None
    return Plan(model, values, Campaign(size.step_s, tuple(runs)), sigma, probes=entries)


def drawn_layout(rng: np.random.Generator) -> tuple[Probe, ...]:
    """Draw three or four probes that tell x, y and Rz apart: two feel y at both sides, the others feel x."""

    def away():
        return float(rng.uniform(0.06, 0.3))

    up = (0.0, float(rng.choice([-1.0, 1.0])))
    across = (float(rng.choice([-1.0, 1.0])), 0.0)
    made = [
        Probe("hall_a_m", (away(), away()), up),
        Probe("hall_b_m", (-away(), away()), up),
        Probe("hall_c_m", (away(), away()), across),
    ]
    if rng.random() < 0.4:
        made.append(Probe("hall_d_m", (-away(), -away()), across))
    return tuple(made)


def drawn_plan(rng: np.random.Generator, size: Size) -> Plan:
    """Draw a stage with a layout of its own."""
    return stage_plan(rng, size, probes=drawn_layout(rng))


def turns(rng: np.random.Generator, size: Size) -> tuple[Run, ...]:
    """Runs of an encoder: turned both ways at several speeds, or swung by more than a turn."""
    seconds, swung, runs = size.samples * size.step_s, rng.random() < 0.4, []
    for k in range(size.runs):
        begin = rng.uniform(0, TURN)
        turned = rng.uniform(1.2, max(1.5, size.samples / 40)) * TURN
        move = ramp((-1) ** k * turned / seconds)
        if swung:
            move = sine(rng.uniform(1.1, 1.5) * np.pi, rng.uniform(1, 2) / seconds, rng.uniform(0, TURN))
        runs.append(Run(seconds, {}, {"angle_rad": lambda t, b=begin, m=move: b + m(t)}))
    return tuple(runs)


def rotary_plan(rng: np.random.Generator, size: Size) -> Plan:
    """Draw an encoder with two voltages."""
    size_v = rng.uniform(0.5, 2.0)
    values = {"Ax": size_v, "Ay": size_v * rng.uniform(0.9, 1.1), "beta": rng.uniform(-0.1, 0.1)}
    values |= {"Vx": size_v * rng.uniform(-0.1, 0.1), "Vy": size_v * rng.uniform(-0.1, 0.1)}
    values["zero"] = rng.uniform(-3, 3)
    level = float(10 ** rng.uniform(-3.7, -2.5))
    sigma = {"v_sin_v": level * size_v, "v_cos_v": level * size_v}
    sigma["angle_ref_rad"] = float(level * rng.uniform(0.05, 0.5))
    return Plan("rotary", values, Campaign(size.step_s, turns(rng, size)), sigma)


def homed_plan(rng: np.random.Generator, size: Size) -> Plan:
    """Draw an encoder whose reference has another zero in each run."""
    plan = rotary_plan(rng, size)
    runs = tuple(replace(run, offsets=(float(rng.uniform(-3, 3)),)) for run in plan.campaign.runs)
    return replace(plan, values={**plan.values, "zero": 0.0}, effects=("zero_deviation",),
                   campaign=replace(plan.campaign, runs=runs))  # fmt: skip


def chip_plan(rng: np.random.Generator, size: Size) -> Plan:
    """Draw an encoder that gives its angle."""
    plan = rotary_plan(rng, size)
    size_v, level = plan.values["Ax"], plan.sigma["v_sin_v"]
    values = {n: v / size_v if n[0] in "AV" else v for n, v in plan.values.items()}
    sigma = {"angle_rad": level / size_v, "angle_ref_rad": plan.sigma["angle_ref_rad"]}
    return replace(plan, values=values, sigma=sigma, probes=[{"channel": "angle_rad"}])


def halbach_plan(rng: np.random.Generator, size: Size) -> Plan:
    """Draw one array over three to six sums at a third of the wavelength."""
    count, wave = int(rng.integers(3, 7)), 0.03
    layout = columns([(k - (count - 1) / 2) * wave / 3 for k in range(count)], wave)
    amplitude = rng.uniform(0.2, 1.5)
    values = {"a1": amplitude, "b1": amplitude * rng.uniform(-0.5, 0.5)}
    values |= {"a5": -0.03 * amplitude, "b5": 0.01 * amplitude * rng.uniform(-1, 1)}
    level = amplitude * float(10 ** rng.uniform(-3.7, -2.7))
    sigma = {f"col_{k}_v": level for k in range(count)} | dict.fromkeys(
        ("x_ref_m", "z_ref_m"), level / amplitude * 5e-3 * rng.uniform(0.1, 1)
    )
    gap, travel, runs = rng.uniform(5e-3, 7e-3), rng.uniform(8e-3, 30e-3), []
    for _ in range(size.runs):
        motion = {"x_m": _waves(travel, rng, size), "z_m": _waves(1e-3, rng, size)}
        setting = {"x_m": float(rng.uniform(-5e-3, 5e-3)), "z_m": float(gap + rng.uniform(-5e-4, 5e-4))}
        runs.append(Run(size.samples * size.step_s, setting, motion))
    entries = [part.entry for part in layout]
    return Plan("halbach", values, Campaign(size.step_s, tuple(runs)), sigma, probes=entries)


def planar_plan(rng: np.random.Generator, size: Size) -> Plan:
    """Draw the mover of four arrays, each over three sums of three sensors."""
    layout, amplitude = three_sums(), rng.uniform(0.3, 1.5)
    model = planar.halbach_planar(layout)
    values = {"a1": amplitude, "a5": -0.03 * amplitude}
    values |= {f"{a}0": rng.uniform(-3e-3, 3e-3) for a in "xy"}
    values |= {f"r{a}0": rng.uniform(-5e-3, 5e-3) for a in "xyz"}
    level = amplitude * float(10 ** rng.uniform(-3.5, -2.7))
    sigma = dict.fromkeys(model.channels, level)
    for c in model.references:
        sigma[c] = level / amplitude * (5e-3 if c.endswith("_m") else 3e-2) * rng.uniform(0.1, 0.5)
    travel = {"x_m": 0.012, "y_m": 0.012, "z_m": 8e-4, "rx_rad": 4e-3, "ry_rad": 4e-3, "rz_rad": 4e-3}
    runs = []
    for _ in range(size.runs):
        motion = {c: _waves(a * rng.uniform(0.6, 1), rng, size) for c, a in travel.items()}
        setting = {"z_m": 6e-3, "x_m": rng.uniform(-3e-3, 3e-3), "y_m": rng.uniform(-3e-3, 3e-3)}
        runs.append(Run(size.samples * size.step_s, setting, motion))
    entries = [part.entry for part in layout]
    return Plan("halbach_planar", values, Campaign(size.step_s, tuple(runs)), sigma, probes=entries)


def three_sums() -> Layout:
    """Return the thesis's mover with the middle three of the six sums under each array: a fit is quick."""
    kept = [s for s in planar.pinwheel() if not isinstance(s, Sensor) or s.channel[-3] in "123"]
    return tuple(kept)


PLANS: dict[str, Callable[[np.random.Generator, Size], Plan]] = {
    "stage30": lambda rng, size: stage_plan(rng, size, model="stage30"),
    "stage31": stage_plan,
    "drawn": drawn_plan,
    "rotary": rotary_plan,
    "homed": homed_plan,
    "chip": chip_plan,
    "halbach": halbach_plan,
    "planar": planar_plan,
}

# -- mistakes ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Mistaken:
    """A log with one mistake.

    `right`: the corrections that undo it, each in full; more than one where they are truly the same. None
    where no correction of the interface does. `columns`, `runs`: where it is, all runs where that is empty.
    `legal`: another machine would have recorded just that, so nobody can tell and nothing is to be said.
    """

    case: str
    kind: str
    recording: Recording
    right: tuple[str, ...]
    columns: tuple[str, ...]
    runs: tuple[int, ...] = ()
    legal: bool = False


@dataclass(eq=False)
class Draft:
    """What a kind of mistake works on: columns that may be changed, and where."""

    r: Recording
    rng: np.random.Generator
    runs: tuple[int, ...]
    arrays: Arrays
    columns: list[str] = field(default_factory=list)
    right: list[str] = field(default_factory=list)
    legal: bool = False

    @property
    def rows(self) -> list[slice]:
        """Rows of each run in which the mistake is made."""
        return [self.r.rows(run) for run in (self.runs or self.r.runs.tolist())]

    @property
    def where(self) -> str:
        return f" in {','.join(map(str, self.runs))}" if self.runs else ""

    def one(self, names: Sequence[str]) -> str:
        return str(self.rng.choice(list(names)))

    def change(self, names: Sequence[str], by: Callable[[np.ndarray], np.ndarray]) -> None:
        """Change columns in the runs of the mistake, run by run."""
        for name in names:
            for rows in self.rows:
                self.arrays[name][rows] = by(self.arrays[name][rows].copy())
        self.columns += [n for n in names if n not in self.columns]

    def say(self, text: str) -> None:
        """Add a correction that undoes the mistake, in the runs in which it is made."""
        self.right.append(text + self.where)


Make = Callable[[Draft], None]
Role = Callable[[Recording], list[str]]
READINGS: Role = attrgetter("readings")
REFERENCES: Role = attrgetter("references")
STATE: Role = attrgetter("state")


def names(columns: Sequence[str]) -> str:
    return ",".join(columns)


def sign(role: Role) -> Make:
    def make(d: Draft) -> None:
        c = d.one(role(d.r))
        d.change([c], np.negative)
        d.say(f"sign {c}")
        d.legal = d.r.family in ENCODERS and not d.runs
        if c in _moving_alone(d):
            d.say(f"sign {names(d.r.readings)}")
        if c == "x_ref_m":
            d.right += [f"exchange {a} {b}{d.where}" for a, b in _ends(d)]

    return make


def all_signs(d: Draft) -> None:
    """The same as half a wavelength, or half a turn, of the reference."""
    d.change(d.r.readings, np.negative)
    d.say(f"sign {names(d.r.readings)}")
    if d.r.family in STAGES:
        d.say(f"sign {names(d.r.references)}")
    for c in _moving_alone(d):
        d.say(f"sign {c}")
    half = {"rotary": ("angle_ref_rad", np.pi), "halbach": ("x_ref_m", 0.015)}
    if d.r.family in half and d.runs:
        column, step = half[d.r.family]
        d.say(f"zero_moved {column} {step:.9g}")
        d.say(f"zero_moved {column} {-step:.9g}")
    d.legal = d.r.family == "homed" or (not d.runs and d.r.family in ("rotary", "halbach", "planar"))


def _ends(d: Draft) -> list[tuple[str, str]]:
    """The outer two of three columns of an array: exchanged, the third stays, and x counts the other way."""
    return [(d.r.readings[0], d.r.readings[2])] if d.r.family == "halbach" and len(d.r.readings) == 3 else []


def _moving_alone(d: Draft) -> list[str]:
    """The one reference that moves in the runs of the mistake, [] if more do: of it and of all readings
    together, what changes one undoes the change of the other."""
    still = [c for c in d.r.references if all(np.ptp(d.r.true[c][rows]) == 0 for rows in d.rows)]
    moving = [c for c in d.r.references if c not in still]
    return moving if d.runs and still and len(moving) == 1 else []


def scaled(role: Role, factor: float, *, every: bool = False) -> Make:
    """The numbers are `factor` times what they should be."""

    def make(d: Draft) -> None:
        columns = role(d.r) if every else [d.one(role(d.r))]
        d.change(columns, lambda x: x * factor)
        d.say(f"scale {names(columns)} {1 / factor:.9g}")
        if columns == d.r.readings:
            for c in _moving_alone(d):
                d.say(f"scale {c} {factor:.9g}")
        elif columns == _moving_alone(d):
            d.say(f"scale {names(d.r.readings)} {factor:.9g}")
        others = [c for c in d.r.readings if c not in columns]
        if d.runs:
            return
        two_voltages = d.r.family in ("rotary", "homed")
        if two_voltages and columns[0] in d.r.readings and others and 0.01 < factor < 100:
            d.say(f"scale {names(others)} {factor:.9g}")
        amplitude_is_free = two_voltages or d.r.family in ARRAYS
        d.legal = amplitude_is_free and columns == d.r.readings

    return make


def of_unit(role: Role, *suffixes: str) -> Role:
    """The columns of a role in these units."""
    return lambda r: [c for c in role(r) if c.endswith(suffixes)]


def lengths(r: Recording) -> list[str]:
    return [c for c in (*r.readings, *r.references, *r.state) if c.endswith("_m")]


def exchanged(role: Role) -> Make:
    def make(d: Draft) -> None:
        one, two = sorted(d.rng.choice(role(d.r), 2, replace=False).tolist())
        a, b = d.arrays[one].copy(), d.arrays[two].copy()
        for rows in d.rows:
            d.arrays[one][rows], d.arrays[two][rows] = b[rows], a[rows]
        d.columns += [one, two]
        d.say(f"exchange {one} {two}")
        d.legal = d.r.family in ENCODERS and not d.runs
        if (one, two) in _ends(d):
            d.say("sign x_ref_m")

    return make


def shifted(x: np.ndarray, samples: int) -> np.ndarray:
    """Values that come `samples` late, early if negative; at the ends the nearest is repeated."""
    return x[np.clip(np.arange(len(x)) - samples, 0, len(x) - 1)]


def late(role: Role, samples: int, *, every: bool = False) -> Make:
    def make(d: Draft) -> None:
        columns = role(d.r) if every else [d.one(role(d.r))]
        n = samples * int(d.rng.choice([-1, 1]))
        d.change(columns, lambda x: shifted(x, n))
        d.say(f"delay {names(columns)} {n}")
        everything = [*d.r.readings, *d.r.references, *d.r.state]
        rest = [c for c in everything if c not in columns]
        d.say(f"delay {names(rest)} {-n}")
        steady = all(np.ptp(d.r.true[c][rows]) == 0 for c in d.r.state for rows in d.rows)
        if every and d.r.state and steady:
            d.say(f"delay {names([c for c in rest if c not in d.r.state])} {-n}")
        alone = _moving_alone(d)
        if columns == alone:
            d.say(f"delay {names(d.r.readings)} {-n}")
        elif alone and columns == d.r.references:
            d.say(f"delay {alone[0]} {n}")
        elif alone and columns == d.r.readings:
            d.say(f"delay {alone[0]} {-n}")

    return make


def _spread(d: Draft, column: str) -> float:
    """Standard deviation of a column's motion, as runs have it in the median."""
    return float(np.median([np.std(d.r.true[column][d.r.rows(run)]) for run in d.r.runs]))


def _moving(d: Draft, columns: Sequence[str]) -> list[str]:
    """The columns that move in the runs of the mistake; those of a grid rest in most."""
    alive = [c for c in columns if all(np.ptp(d.r.true[c][rows]) > 20 * d.r.sigma[c] for rows in d.rows)]
    return alive or list(columns)


def zero_moved(role: Role) -> Make:
    def make(d: Draft) -> None:
        c = d.one(role(d.r))
        step = d.rng.choice([-1, 1]) * max(0.03 * _spread(d, c), 12 * d.r.sigma[c]) * d.rng.uniform(1, 4)
        either = {c: step}
        if d.r.family == "chip":
            either = {one: step if one == c else -step for one in (*d.r.readings, *d.r.references)}
        for run, rows in zip(d.runs, d.rows, strict=True):
            at = int(d.rng.uniform(0.25, 0.75) * (rows.stop - rows.start))
            d.arrays[c][rows.start + at : rows.stop] += step
            d.right += [f"zero_moved {one} {by:.9g} from {at} in {run}" for one, by in either.items()]
        d.columns.append(c)

    return make


def clipped(role: Role, share: float) -> Make:
    def make(d: Draft) -> None:
        c = d.one(_moving(d, role(d.r)))
        seen = np.concatenate([d.arrays[c][rows] for rows in d.rows])
        both = d.rng.random() < 0.5
        low = float(np.quantile(seen, share / 2)) if both else -np.inf
        high = float(np.quantile(seen, 1 - (share / 2 if both else share)))
        d.change([c], lambda x: np.clip(x, low, high))
        d.say(f"clipped {c} {low:.9g} {high:.9g}")

    return make


def mean_of(x: np.ndarray, samples: int) -> np.ndarray:
    """Centred means, fewer samples at the ends."""
    ones = np.ones(samples)
    return np.convolve(x, ones, "same") / np.convolve(np.ones(len(x)), ones, "same")


def averaged(role: Role, samples: int, *, every: bool = False) -> Make:
    def make(d: Draft) -> None:
        columns = role(d.r) if every else [d.one(_moving(d, role(d.r)))]
        d.change(columns, lambda x: mean_of(x, samples))
        d.say(f"averaged {names(columns)} {samples}")

    return make


def coarse(role: Role, bits: int, *, every: bool = False) -> Make:
    """So many bits for the travel of each column, at most for a turn."""

    def make(d: Draft) -> None:
        for c in role(d.r) if every else [d.one(_moving(d, role(d.r)))]:
            span = float(np.ptp(d.r.true[c]))
            step = (min(span, TURN) if d.r.family in ENCODERS else span) / 2**bits
            d.change([c], lambda x, h=step: np.round(x / h) * h)
            d.say(f"coarse_steps {c} {step:.9g}")

    return make


def stuck(role: Role, *, every: bool = False, extreme: bool = False) -> Make:
    def make(d: Draft) -> None:
        columns = role(d.r) if every else [d.one(_moving(d, role(d.r)))]
        for run, rows in zip(d.runs, d.rows, strict=True):
            n = rows.stop - rows.start
            length = max(4, int(d.rng.uniform(0.08, 0.4) * n))
            start = int(d.rng.integers(0, n - length))
            if extreme:  # a rail has others beyond it
                start = min(int(np.argmax(d.arrays[columns[0]][rows])), n - length)
            for c in columns:
                d.arrays[c][rows.start + start : rows.start + start + length] = d.arrays[c][
                    rows.start + start
                ]
            d.right.append(f"stuck {names(columns)} {start} {start + length} in {run}")
        d.columns += columns

    return make


def blocks(role: Role) -> Make:
    """Write a block of each run twice, in place of the next one: a buffer that was sent again."""

    def make(d: Draft) -> None:
        place, share = d.rng.uniform(0.3, 0.6), d.rng.uniform(0.1, 0.25)

        def again(x: np.ndarray) -> np.ndarray:
            at, length = int(place * len(x)), max(8, int(share * len(x)))
            x[at : at + length] = x[at - length : at]
            return x

        d.change(columns := role(d.r), again)
        d.say(f"stuck {names(columns)}")

    return make


def copied(d: Draft) -> None:
    """A run holds what another one holds, on a clock of its own."""
    source = int(d.rng.choice([r for r in d.r.runs if r not in d.runs]))
    for run in d.runs:
        for c in (*d.r.readings, *d.r.references, *d.r.state):
            d.arrays[c][d.r.rows(run)] = d.arrays[c][d.r.rows(source)]
        d.right += [f"copied_run in {run}", f"copied_run in {source}"]


def other_device(d: Draft) -> None:
    """The readings of some runs are those of another device, with gains of its own."""
    low, spread = (0.03, 0.12) if d.r.family in STAGES else (0.02, 0.15)
    gains = 1 + d.rng.choice([-1, 1], len(d.r.readings)) * d.rng.uniform(low, spread, len(d.r.readings))
    if d.r.family == "chip":  # another ellipse
        e, a = d.rng.uniform(0.02, 0.1), d.rng.uniform(0, TURN)
        d.change(d.r.readings, lambda x: np.mod(x + e * np.sin(x + a), TURN))
    else:
        for c, gain in zip(d.r.readings, gains, strict=True):
            d.change([c], lambda x, g=gain: x * g)
    d.say("other_device")
    rest = [r for r in d.r.runs.tolist() if r not in d.runs]
    if len(d.runs) >= len(rest):
        d.right.append(f"other_device in {','.join(map(str, rest))}")


def gain_step(role: Role, by: float) -> Make:
    def make(d: Draft) -> None:
        c = d.one(_moving(d, role(d.r)))
        factor = 1 + by * float(d.rng.choice([-1, 1]))
        d.change([c], lambda x: x * factor)
        d.say(f"gain_step {c} {factor:.9g}")
        if [c] == _moving_alone(d):
            d.say(f"gain_step {names(d.r.readings)} {1 / factor:.9g}")

    return make


def zeroed(d: Draft) -> None:
    """A gap has lost its zero: each run is written as deviations from its mean."""
    d.change(["z_ref_m"], lambda x: x - x.mean())


@dataclass(frozen=True)
class Kind:
    """A kind of mistake: how it is made, `scope` (in which runs), and in which families it can be made."""

    name: str
    make: Make
    scope: str
    role: Role
    least: int = 1
    """Columns of the role that it needs."""
    only: tuple[str, ...] = FAMILIES


def _kinds() -> tuple[Kind, ...]:
    out: list[Kind] = []

    def add(name: str, make: Make, role: Role, scopes: str = "log run few", **about) -> None:
        out.extend(Kind(f"{name}, {scope}", make, scope, role, **about) for scope in scopes.split())

    linear = tuple(f for f in FAMILIES if f != "chip")
    for role, what, own, steady in (
        (READINGS, "reading", linear, linear),
        (REFERENCES, "reference", FAMILIES, tuple(f for f in FAMILIES if f not in ENCODERS)),
    ):
        add(f"sign of a {what}", sign(role), role)
        for factor in (1e3, 1e-3, 10.0, 0.1):
            add(f"{what} x {factor:g}", scaled(role, factor), role, "log run" if factor > 1 else "log")
        add(f"{what} in inches", scaled(of_unit(role, "_m"), 1 / 0.0254), of_unit(role, "_m"), "log")
        add(f"{what} in counts", scaled(role, 1 / 0.37e-4), role, "log")
        add(f"two {what}s exchanged", exchanged(role), role, "log run", least=2)
        for n in (1, 2, 5, 20):
            add(f"{what} {n} samples off", late(role, n), role, "log run" if n > 1 else "log")
            add(f"all {what}s {n} samples off", late(role, n, every=True), role, "log run", least=2)
        add(f"zero of a {what} moved", zero_moved(role), role, "run few")
        for share in (0.01, 0.05, 0.2):
            scopes = "log run" if share > 0.02 else "log"
            add(f"{what} clipped in {share:.0%}", clipped(role, share), role, scopes, only=own)
        for n in (3, 5, 9):
            add(f"{what} averaged over {n}", averaged(role, n), role, "log", only=linear)
            add(f"all {what}s averaged over {n}", averaged(role, n, every=True), role, "log run", least=2)
        for bits in (3, 5, 8):
            add(f"{what} of {bits} bits", coarse(role, bits), role, "log run" if bits < 8 else "log")
        add(f"all {what}s of 5 bits", coarse(role, 5, every=True), role, "log", least=2)
        add(f"{what} stuck", stuck(role), role, "run few")
        add(f"all {what}s stuck", stuck(role, every=True), role, "run", least=2)
        for by in (0.05, 0.2):
            add(f"{what} gain {by:+.0%}", gain_step(role, by), role, "run tail", only=steady)
    add("all readings inverted", all_signs, READINGS, "log run", least=2)
    angles, degree = of_unit(REFERENCES, "_rad"), np.pi / 180
    add("reference in degrees", scaled(angles, 1 / degree), angles, "log run")
    add("reference taken for degrees", scaled(angles, degree), angles, "log")
    for factor in (1e3, 1e-3, 10.0, 0.1):
        add(f"all readings x {factor:g}", scaled(READINGS, factor, every=True), READINGS, "log", least=2)
    add("all lengths x 1000", scaled(lengths, 1e3, every=True), lengths, "log", only=(*STAGES, "halbach"))
    add("all readings x 10", scaled(READINGS, 10.0, every=True), READINGS, "run", least=2)
    add("copied run", copied, READINGS, "run")
    add("another device", other_device, READINGS, "run few half")
    heights = ("stage31", "drawn")
    add("sign of a state", sign(STATE), STATE, "log run", only=heights)
    for factor in (1e3, 10.0, 180 / np.pi):
        add(f"state x {factor:.3g}", scaled(STATE, factor), STATE, "log run", only=heights)
    add("two states exchanged", exchanged(STATE), STATE, "log run", only=heights)
    add("gap zeroed", zeroed, of_unit(REFERENCES, "z_ref_m"), "log", only=("halbach", "planar"))
    for role, what in ((READINGS, "reading"), (REFERENCES, "reference")):
        add(f"{what} stuck at its extreme", stuck(role, extreme=True), role, "run")
        add(f"blocks of {what}s repeated", blocks(role), role, "log")
    return tuple(out)


KINDS = {kind.name: kind for kind in _kinds()}


def cases(seed: int, repeat: int = 1) -> list[tuple[str, str, str]]:
    """Return every kind with every family that it can be made in, and seeds: (kind, family, seed)."""
    found = []
    for kind in KINDS.values():
        for family in kind.only:
            if len(kind.role(_sample(family))) >= kind.least:
                found += [(kind.name, family, f"{seed}.{k}") for k in range(repeat)]
    return found


@cache
def _sample(family: str) -> Recording:
    """A recording from which the columns of a family are known."""
    return machine(family, "sample", size=Size(5, 60, 1e-2))


MACHINES = {"planar": 3}
"""How many machines a seed has in a family; more where a fit is quick."""


@cache
def twin(family: str, seed: str, number: int, size: Size | None = None) -> Recording:
    """The healthy recording that a mistake is made in."""
    return machine(family, (seed, number), size)


def mistaken(kind: str, family: str, seed: str, size: Size | None = None) -> Mistaken:
    """Make one mistake in the recording of a machine; all is drawn by kind, family and seed.

    `size`: how much is recorded, drawn too by default.
    """
    rng, known = drawn_by(kind, family, seed), KINDS[kind]
    r = twin(family, seed, int(rng.integers(MACHINES.get(family, 24))), size)
    every = r.runs.tolist()
    count = {"log": 0, "run": 1, "few": int(rng.integers(2, max(3, len(every) // 4 + 1)))}.get(
        known.scope, len(every) // 2
    )
    runs = sorted(rng.choice(every, count, replace=False).tolist())
    if known.scope in ("tail", "half"):
        runs = every[int(rng.integers(len(every) // 2 + 1, len(every))) :] if known.scope == "tail" else \
            every[: len(every) // 2]  # fmt: skip
    draft = Draft(r, rng, tuple(runs), {c: x.copy() for c, x in r.arrays.items()})
    known.make(draft)
    return Mistaken(
        f"{kind}/{family}/{seed}", kind, replace(r, arrays=draft.arrays), tuple(draft.right),
        tuple(draft.columns), draft.runs, draft.legal,
    )  # fmt: skip


# -- healthy logs ------------------------------------------------------------------------------------------

Planned = Callable[[Plan, np.random.Generator], Plan]
After = Callable[[Recording, np.random.Generator], Recording]


def _same(plan: Plan, rng: np.random.Generator) -> Plan:
    return plan


def _as_it_is(r: Recording, rng: np.random.Generator) -> Recording:
    return r


@dataclass(frozen=True)
class Healthy:
    """A kind of healthy log: how much is recorded, what is changed in the plan, and in the log."""

    families: tuple[str, ...] = FAMILIES
    size: Callable[[np.random.Generator], Size] | None = None
    plan: Planned = _same
    after: After = _as_it_is
    coloured: bool = False


def healthy(kind: str, family: str, seed: str) -> Recording:
    """Record a log without a mistake."""
    rng, known = drawn_by("healthy", kind, family, seed), HEALTHY[kind]
    size = known.size(rng) if known.size else size_of(family, rng)
    if family == "planar":
        size = replace(size, runs=min(size.runs, 6), samples=min(size.samples, 60))
    plan = known.plan(PLANS[family](rng, size), rng)
    r = recorded(family, plan, rng, stated=rng.random() < 0.6, coloured=known.coloured)
    return known.after(r, rng)


def healthy_cases(seed: int, repeat: int = 1) -> list[tuple[str, str, str]]:
    """Return every kind of healthy log with every family that it is made of: (kind, family, seed)."""
    return [(name, family, f"{seed}.{k}") for name, kind in HEALTHY.items() for family in kind.families
            for k in range(repeat)]  # fmt: skip


def moving(change: Callable[[AtTimes, float, np.random.Generator], AtTimes]) -> Planned:
    """Change the motion of each axis in each run; `change(motion, seconds, rng)`."""

    def made(plan: Plan, rng: np.random.Generator) -> Plan:
        runs = []
        for run in plan.campaign.runs:
            motion = {axis: change(at, run.duration_s, rng) for axis, at in run.motion.items()}
            runs.append(replace(run, motion=motion))
        return replace(plan, campaign=replace(plan.campaign, runs=tuple(runs)))

    return made


def dwelling(at: AtTimes, seconds: float, rng: np.random.Generator) -> AtTimes:
    """Rest at a dozen places, one after the other."""
    dwell = seconds / int(rng.integers(8, 30))
    return lambda t: at(dwell * np.floor(t / dwell))


def late_start(at: AtTimes, seconds: float, rng: np.random.Generator) -> AtTimes:
    """Rest at the beginning and at the end of a run."""
    begin, end = seconds * rng.uniform(0, 0.3), seconds * rng.uniform(0.7, 1)
    return lambda t: at(np.clip(t, begin, end))


def there_and_back(at: AtTimes, seconds: float, rng: np.random.Generator) -> AtTimes:
    """Run through a motion and back again."""
    return lambda t: at(seconds * (1 - np.abs(2 * t / seconds - 1)))


def between_stops(at: AtTimes, seconds: float, rng: np.random.Generator) -> AtTimes:
    """Rest where the travel ends: the motion is cut off, not what is recorded of it."""
    seen = at(np.linspace(0, seconds, 200))
    low, high = np.quantile(seen, [rng.uniform(0, 0.2), rng.uniform(0.8, 1)])
    return lambda t: np.clip(at(t), low, high)


def stepping(at: AtTimes, seconds: float, rng: np.random.Generator) -> AtTimes:
    """Move in steps of a motor, 20 to 200 over the travel."""
    step = np.ptp(at(np.linspace(0, seconds, 200))) / rng.uniform(20, 200) + 1e-15
    return lambda t: step * np.round(at(t) / step)


def one_at_rest(plan: Plan, rng: np.random.Generator) -> Plan:
    """Nothing moves in one run."""
    runs = list(plan.campaign.runs)
    k = int(rng.integers(len(runs)))
    still = {axis: float(at(np.zeros(1))[0]) for axis, at in runs[k].motion.items()}
    at_rest = {axis: runs[k].setting.get(axis, 0.0) + value for axis, value in still.items()}
    runs[k] = replace(runs[k], motion={}, setting={**runs[k].setting, **at_rest})
    return replace(plan, campaign=replace(plan.campaign, runs=tuple(runs)))


def unequal(plan: Plan, rng: np.random.Generator) -> Plan:
    """Runs of different lengths."""
    runs = tuple(
        replace(run, duration_s=run.duration_s * rng.uniform(0.4, 1.6)) for run in plan.campaign.runs
    )
    return replace(plan, campaign=replace(plan.campaign, runs=runs))


def repeated(plan: Plan, rng: np.random.Generator) -> Plan:
    """Record each motion two or three times, with other zeros and other noise."""
    runs = tuple(run for run in plan.campaign.runs for _ in range(int(rng.integers(2, 4))))[:60]
    return replace(plan, campaign=replace(plan.campaign, runs=runs))


def values_of(change: Callable[[str, float, np.random.Generator], float]) -> Planned:
    """Change values of parameters, by name."""

    def made(plan: Plan, rng: np.random.Generator) -> Plan:
        return replace(plan, values={name: change(name, v, rng) for name, v in plan.values.items()})

    return made


def without(*first: str) -> Planned:
    """Set parameters to 0 whose names begin so."""
    return values_of(lambda name, v, rng: 0.0 if name.startswith(first) else v)


def stated_gains(gain: float) -> Planned:
    """Gains about `gain`, whose bounds a machine file states."""

    def made(plan: Plan, rng: np.random.Generator) -> Plan:
        gains = [name for name in plan.values if name.startswith("eta_")]
        bounds = {"nominal": gain, "lower": gain - 0.15, "upper": gain + 0.15}
        values = {**plan.values, **{name: gain * rng.uniform(0.95, 1.05) for name in gains}}
        return replace(plan, values=values, parameters={name: dict(bounds) for name in gains})

    return made


def near(plan: Plan, rng: np.random.Generator) -> Plan:
    """Probes at 50 mm, as a machine file says."""

    def at():
        return float(rng.uniform(0.04, 0.06))

    probes = (Probe("hall_a_m", (at(), at()), (0.0, 1.0)), Probe("hall_b_m", (-at(), at()), (0.0, 1.0)),
              Probe("hall_c_m", (at(), at()), (1.0, 0.0)))  # fmt: skip
    return stage_plan(rng, Size(len(plan.campaign.runs), 200, plan.campaign.step_s), probes=probes)


def ellipse(plan: Plan, rng: np.random.Generator) -> Plan:
    """An ellipse of 1.3 : 1."""
    factor = float(rng.choice([1 / 1.3, 1.3]))
    return replace(plan, values={**plan.values, "Ay": factor * plan.values["Ax"]})


def turned_round(r: Recording, rng: np.random.Generator) -> Recording:
    """A machine that counts the other way, a plate mounted on its other side, or plates exchanged."""
    arrays = dict(r.arrays)
    if rng.random() < 0.5 or r.family == "chip":
        arrays["angle_ref_rad"] = -arrays["angle_ref_rad"]
    elif rng.random() < 0.5:
        arrays["v_sin_v"], arrays["v_cos_v"] = arrays["v_cos_v"], arrays["v_sin_v"]
    else:
        arrays["v_cos_v"] = -arrays["v_cos_v"]
    return replace(r, arrays=arrays)


def jittered(r: Recording, rng: np.random.Generator) -> Recording:
    """Samples at times that scatter about the clock, as they are written."""
    step = np.median(np.diff(r.arrays["t_s"]))
    scatter = rng.uniform(0.02, 0.3) * step * rng.uniform(-1, 1, len(r.arrays["t_s"]))
    return replace(r, arrays={**r.arrays, "t_s": r.arrays["t_s"] + scatter})


def missing(r: Recording, rng: np.random.Generator) -> Recording:
    """Some samples are missing."""
    return kept(r, rng.random(len(r.true["run"])) > rng.uniform(0.001, 0.02))


def converted(r: Recording, rng: np.random.Generator) -> Recording:
    """Readings of a converter of 12 bits, whose steps are no larger than twice the noise."""
    arrays, stated = dict(r.arrays), dict(r.stated)
    for c in r.readings:
        span = TURN if r.family == "chip" else 1.5 * np.ptp(r.true[c])
        step = min(span / 2**12, 2 * r.sigma[c])
        arrays[c] = step * np.round(arrays[c] / step)
        if c in stated:
            stated[c] = float(np.hypot(stated[c], step / np.sqrt(12)))
    return replace(r, arrays=arrays, stated=stated)


def commanded(r: Recording, rng: np.random.Generator) -> Recording:
    """References without noise, written to nanometres or microradians: those that a controller commanded."""
    arrays = {c: x if c not in r.references else np.round(r.true[c], 9) for c, x in r.arrays.items()}
    stated = {c: s for c, s in r.stated.items() if c not in r.references}
    return replace(r, arrays=arrays, stated=stated)


def partly_stated(r: Recording, rng: np.random.Generator) -> Recording:
    """The noise of some columns is stated."""
    return replace(r, stated={c: s for c, s in r.sigma.items() if rng.random() < 0.5})


def noisy_run(r: Recording, rng: np.random.Generator) -> Recording:
    """One run is twice as noisy."""
    rows, arrays = r.rows(int(rng.choice(r.runs))), {c: x.copy() for c, x in r.arrays.items()}
    for c in r.readings:
        arrays[c][rows] += 1.7 * r.sigma[c] * rng.standard_normal(rows.stop - rows.start)
    return replace(r, arrays=arrays)


def heavy(r: Recording, rng: np.random.Generator) -> Recording:
    """Noise of Student's t with 5 degrees of freedom, and few spikes."""
    arrays = dict(r.arrays)
    for c in (*r.readings, *r.references):
        n = len(r.true[c])
        noise = rng.standard_t(5, n) * np.sqrt(3 / 5) + 20 * (rng.random(n) < 5e-4)
        arrays[c] = r.true[c] + r.sigma[c] * noise
    return replace(r, arrays=arrays)


def disturbed(change: Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]) -> After:
    """Change what each reading sees: `change(values of a run, share of the log, rng)`, before noise."""

    def made(r: Recording, rng: np.random.Generator) -> Recording:
        arrays, share = dict(r.arrays), np.linspace(0, 1, len(r.true["run"]))
        for c in r.readings:
            own = np.random.default_rng(int(rng.integers(2**31)))
            state = own.bit_generator.state
            out = arrays[c].copy()
            for run in r.runs:
                own.bit_generator.state = state
                rows = r.true["run"] == run
                x = r.true[c][rows]
                out[rows] += change(x, share[rows], own) - x
            arrays[c] = out
        return replace(r, arrays=arrays)

    return made


def _play(x: np.ndarray, share: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Hysteresis: the reading follows a play of 1 % of the span, by a tenth."""
    width, out, p = 0.01 * np.ptp(x) + 1e-12, np.empty_like(x), x[0]
    for k, value in enumerate(x):
        p = min(max(p, value - width), value + width)
        out[k] = p
    return x + rng.uniform(0.05, 0.2) * (out - x)


def _lag(x: np.ndarray, share: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A lag of a part of a sample."""
    a = rng.uniform(0.1, 0.5)
    return x - a * np.gradient(x) if len(x) > 2 else x


def _warm(x: np.ndarray, share: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The gain drifts by up to 2 % in the log, smoothly."""
    return x * (1 + rng.uniform(0.003, 0.02) * (1 - np.exp(-3 * share)))


def _cubic(x: np.ndarray, share: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A field that bends by up to 1 %."""
    size = np.abs(x).max() + 1e-12
    return x + rng.uniform(-0.01, 0.01) * x * (x / size) ** 2


def _hum(x: np.ndarray, share: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Mains hum, aliased as the clock has it."""
    w = rng.uniform(0.3, 2.8)
    return x + rng.uniform(0.001, 0.01) * np.std(x) * np.sin(w * np.arange(len(x)) + rng.uniform(0, TURN))


def harmonics(r: Recording, rng: np.random.Generator) -> Recording:
    """The field of an encoder has harmonics of up to 1 %, and its magnet is eccentric."""
    arrays, angle = dict(r.arrays), r.true["angle_ref_rad"]
    for c in r.readings:
        a, phase = rng.uniform(0.002, 0.01, 2), rng.uniform(0, TURN, 2)
        size = 1.0 if r.family == "chip" else np.ptp(r.true[c]) / 2
        arrays[c] = arrays[c] + size * (
            a[0] * np.sin(2 * angle + phase[0]) + a[1] * np.sin(3 * angle + phase[1])
        )
        if r.family == "chip":
            arrays[c] = np.mod(arrays[c], TURN)
    return replace(r, arrays=arrays)


HEALTHY: dict[str, Healthy] = {
    "as drawn": Healthy(),
    "coloured noise": Healthy(coloured=True),
    "short runs": Healthy(size=lambda g: Size(int(g.integers(20, 61)), int(g.integers(15, 40)), 5e-3)),
    "slow clock": Healthy(size=lambda g: Size(int(g.integers(5, 20)), 100, float(g.uniform(0.1, 5)))),
    "one run": Healthy(("stage30", *ENCODERS, *ARRAYS), size=lambda g: Size(1, 600, 2e-3)),
    "500 short slow runs": Healthy((*STAGES, *ENCODERS, "halbach"), size=lambda g: Size(500, 50, 0.5)),
    "dwells": Healthy(plan=moving(dwelling)),
    "rest before and after": Healthy(plan=moving(late_start)),
    "there and back": Healthy(plan=moving(there_and_back)),
    "end stops": Healthy(plan=moving(between_stops)),
    "end stops, commanded": Healthy(plan=moving(between_stops), after=commanded),
    "stepper, commanded": Healthy(plan=moving(stepping), after=commanded),
    "a run at rest": Healthy(plan=one_at_rest),
    "a noisy run": Healthy(after=noisy_run),
    "unequal runs": Healthy(plan=unequal),
    "repeated runs": Healthy(plan=repeated),
    "jitter": Healthy(after=jittered),
    "missing samples": Healthy(after=missing),
    "12 bits": Healthy(after=converted),
    "commanded reference": Healthy(after=commanded),
    "noise partly stated": Healthy(after=partly_stated),
    "heavy tails and spikes": Healthy(after=heavy),
    "gain follows height alone": Healthy(("stage31", "drawn"), plan=without("b_", "c_")),
    "gain follows nothing": Healthy(("stage31", "drawn"), plan=without("a_", "b_", "c_")),
    "probes at 50 mm": Healthy(("stage31",), plan=near),
    "gains of 0.8": Healthy(STAGES, plan=stated_gains(0.8)),
    "gains of 1.2": Healthy(STAGES, plan=stated_gains(1.2)),
    "ellipse of 1.3": Healthy(ENCODERS, plan=ellipse),
    "turned round": Healthy(ENCODERS, after=turned_round),
    "hysteresis": Healthy((*STAGES, "rotary", "homed", *ARRAYS), after=disturbed(_play)),
    "lag below a sample": Healthy((*STAGES, "rotary", "homed", *ARRAYS), after=disturbed(_lag)),
    "temperature drift": Healthy((*STAGES, "rotary", "homed", *ARRAYS), after=disturbed(_warm)),
    "bent field": Healthy((*STAGES, "rotary", "homed", *ARRAYS), after=disturbed(_cubic)),
    "hum": Healthy((*STAGES, "rotary", "homed", *ARRAYS), after=disturbed(_hum)),
    "harmonics": Healthy(ENCODERS, after=harmonics),
}
