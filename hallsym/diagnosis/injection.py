"""Readings of a machine whose gap is known: a fitted model on a log's own motion, with an effect or fault.

The recorded reference, vertical state, time and temperature are taken as the truth. An effect acts through
its own model (`hallsym.diagnosis.effect`), exactly; a fault of samples acts on the readings.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import casadi as ca
import numpy as np

from hallsym.arrays import on_arrays
from hallsym.batches import Batch, batches
from hallsym.computed import extended, rate
from hallsym.decoding import columns_of
from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.ranking import Trouble, candidates
from hallsym.diagnosis.refit import solve
from hallsym.diagnosis.tangent import Base, tangents
from hallsym.diagnosis.words import gap_text, gap_unit
from hallsym.families.rotary_cordic import MOST_STEPS, cordic_angle, worst_of
from hallsym.log import Log, Noise, Sigma
from hallsym.model import Model
from hallsym.turning import wrapped

HUM_HZ = 50.03
"""Mains frequency of the simulated pick-up: mains are never at 50 Hz exactly."""
OUTLIERS = 0.003
"""Share of samples that are spikes."""
HOLD = 3
"""Samples for which a stale reading is held at most."""
ABSORBED = 0.02
"""Share of an effect that must be left by the model's own parameters for it to count as visible."""
SEEN = 1e-3
"""A parameter that makes less than this part of the noise floor at its bound is left at 0."""
NEAR = 0.02
"""How near the gap of an injection must come to what is wanted."""
SEARCH = 12
MANY = 10
"""Fitted runs from which on a probe slips between two of them and not within one."""
FEWEST_STEPS = 4
"""Steps of CORDIC of which an encoder has at least: 7 deg of error."""
MOST_SHARE = 0.3
"""Share of stale or clipped samples beyond which a recording is no longer one."""


@dataclass(frozen=True, eq=False)
class Truth:
    """A fitted model as the machine: `base` holds the log with the motion, the values and the zeros.

    `clean`: its readings without noise, (K, rows). `speed`: d clean / dt along the smoothed motion.
    `floor_m`: gap metric that the stated noise makes. `origin_s`: time of the first sample.
    """

    base: Base
    columns: Mapping[str, np.ndarray]
    clean: np.ndarray
    speed: np.ndarray
    floor_m: float

    @property
    def runs(self) -> list[int]:
        """Runs that are fitted."""
        return [r for r in self.base.log.runs if r not in self.base.apart]

    def log(self, readings: np.ndarray) -> Log:
        """Return the log with other readings, (K, rows); its noise is stated."""
        base = self.base
        rows = dict(zip(base.model.channels, readings, strict=True))
        noise = Noise({c: Sigma(s, "given") for c, s in base.sigma.items()})
        meta = replace(base.log.meta, holdout=tuple(sorted(base.apart)))
        return Log.from_arrays({**self.columns, **rows}, noise, meta, "a simulated log")

    def gap(self, readings: np.ndarray) -> tuple[float, float]:
        """Gap metric [m] of noise-free readings on the held-out runs: with the model fitted, and before."""
        t = tangents(replace(self.base, log=self.log(readings)), {})
        n = len(self.base.free)
        known, judged = t.units(self.runs), t.units(tuple(self.base.apart))
        theta = solve(t.likelihood[known].sum(axis=0), np.arange(n))
        v = np.concatenate([-theta, [1.0]])
        out = t.output[judged].sum(axis=0) / max(t.count[judged].sum(), 1.0)
        return float(np.sqrt(max(v @ out @ v, 0.0))), float(np.sqrt(max(out[-1, -1], 0.0)))


def truth_of(base: Base, floor_m: float) -> Truth:
    """Return the machine of a fitted model on the motion that `base.log` recorded."""
    columns = {c: base.log.array(c) for c in base.log.columns if c not in base.model.channels}
    columns["run"] = columns["run"].astype(int)
    base = replace(base, keep=None)
    return Truth(base, columns, readings_of(base, base.model, base.p), _speed(base), floor_m)


def readings_of(base: Base, model: Model, p: np.ndarray) -> np.ndarray:
    """Return the readings (K, rows) of `model`, an extension of the base's, with values `p`."""
    run = on_arrays(model.reading)
    log = extended(base.log, model, base.sigma, base.values)
    parts = []
    for batch in batches(log, columns_of(model)):
        zeros = _zeros(base, batch)
        parts.append(run(p, zeros, batch.columns(model.references), batch.columns(model.state))[0])
    return np.hstack(parts)


def _zeros(base: Base, batch: Batch) -> np.ndarray:
    own = np.array([base.zeros.get(b.run, np.zeros(len(base.model.zeros))) for b in batch.blocks])
    return np.repeat(own, np.diff(batch.edges), axis=0).T


def _speed(base: Base) -> np.ndarray:
    """Velocity of the readings along the smoothed motion, (K, rows) in m/s."""
    model, s = base.model, base.model.symbols
    axes = [rate(c) for c in model.references]
    velocity = ca.SX.sym("velocity", len(axes))
    moved = ca.jacobian(s.full(s.reading), s.pose) @ velocity
    run = on_arrays(ca.Function("moved", [s.parameters, s.zeros, s.pose, s.state, velocity],
                                [ca.densify(moved)]))  # fmt: skip
    log = extended(base.log, model.with_columns(*axes), base.sigma, base.values)
    names = [a.name for a in axes]
    parts = [
        run(base.p, _zeros(base, b), b.columns(model.references), b.columns(model.state), b.columns(names))[0]
        for b in batches(log, (*columns_of(model), *names))
    ]
    return np.hstack(parts)


# -- what is injected --------------------------------------------------------------------------------------

Size = dict[str, tuple[float, str]]
"""Parameter -> value in SI, unit."""
Noisy = np.ndarray | float
"""Noise of the readings, (K, rows), or 0."""


@dataclass(frozen=True, eq=False)
class Injection:
    """An effect or a fault that can be given any size.

    `make(amount, noise) -> readings`: (K, rows), `noise` alike or 0. `size(amount)`: its parameters. `most`:
    amount beyond which it is no longer what its name says. `start`: an amount to begin the search from.
    `sized`: False where there is nothing to scale (an exchanged channel).
    """

    name: str
    link: str
    form: str
    make: Callable[[float, Noisy], np.ndarray]
    size: Callable[[float], Size]
    most: float
    start: float = 1.0
    sized: bool = True


@dataclass(frozen=True)
class Sized:
    """How large an injection must be for a gap: `reason` says why there is no such amount."""

    amount: float
    gap_m: float
    reason: str = ""


def sized(truth: Truth, injection: Injection, ratio: float) -> Sized:
    """Scale an injection until its noise-free gap with the floor is `ratio` times the floor."""
    wanted = truth.floor_m * float(np.sqrt(ratio**2 - 1))
    amount, slope, seen = min(injection.start, injection.most), 1.0, [(0.0, 0.0)]
    for _ in range(SEARCH):
        readings = injection.make(amount, 0.0)
        if not np.isfinite(readings).all():
            return Sized(amount, 0.0, "its readings are not finite on this log")
        gap, raw = truth.gap(readings)
        hidden = gap < ABSORBED * raw and raw > truth.floor_m
        if hidden or (amount >= injection.most and gap < (1 - NEAR) * wanted):
            return Sized(amount, gap, _invisible(gap, raw, gap_unit(truth.base.model.pose)))
        before = seen[-1]
        seen.append((amount, gap))
        if abs(gap / wanted - 1) < NEAR:
            break
        if min(gap, *before) > 0 and before[0] != amount:
            slope = float(np.log(gap / before[1]) / np.log(amount / before[0]))
        factor = (wanted / gap) ** (1 / np.clip(slope, 0.4, 4.0)) if gap > 0 else 10.0
        amount = float(min(amount * np.clip(factor, 0.02, 50.0), injection.most))
    return Sized(*min(seen[1:], key=lambda s: abs(s[1] - wanted)))


def _invisible(gap: float, raw: float, unit: tuple[float, str]) -> str:
    left = gap_text(gap, unit, 2)
    if gap < ABSORBED * raw:
        return f"the model's own parameters absorb it: of {gap_text(raw, unit)} they leave {left}"
    return f"at the bounds of its parameters it makes {left} on this log"


def _unit(truth: Truth) -> str:
    """Unit of the readings, as parameters have it."""
    unit = truth.base.model.channels[0].rpartition("_")[2]
    return "V" if unit == "v" else unit


def _goes_round(truth: Truth) -> bool:
    """Whether the reading is the decoded angle: one channel without rails or other wires."""
    return truth.base.model.channels == truth.base.model.pose


def injections(
    truth: Truth, catalogue: Sequence[Effect], rng_of: Callable[[str], np.random.Generator]
) -> tuple[list[Injection], dict[str, str]]:
    """Return everything that can be injected into this log, and why the others cannot."""
    facts = _facts(truth, rng_of("mount_slip"))
    tried, trouble = candidates(truth.base, catalogue, facts)
    reasons = _reasons(truth.base, catalogue, {key.split("|")[0] for key in tried}, trouble)
    t = tangents(truth.base, {key: (model, new) for key, (_, _, model, new) in tried.items()})
    strength = np.diag(t.output.sum(axis=0)) / t.count.sum()
    out = []
    for effect in catalogue:
        own = [key for key in tried if key.split("|")[0] == effect.name and key not in t.spoiled]
        if not own:
            continue
        key = own[0] if tried[own[0]][1].shape is None else own[(len(own) - 1) // 2]
        _, variant, model, new = tried[key]
        if effect.name == "saturation":
            if _goes_round(truth):
                reasons[effect.name] = "an angle has no rails; the voltages are not logged"
            else:
                out.append(_rails(truth, effect))
            continue
        raw = np.sqrt(np.maximum(strength[t.span[key]], 0.0))
        made = _effect(truth, effect, variant, model, new, raw, rng_of(effect.name))
        if made is None:
            reasons[effect.name] = "this log has no motion that would show it"
        else:
            out.append(made)
    if _goes_round(truth):
        reasons |= dict.fromkeys(("channel_swap", "sign_inversion"), "one channel has no wires to mix up")
    else:
        reasons["cordic_steps"] = "the readings are no angles"
    return out + _faults(truth, rng_of), reasons


def _reasons(
    base: Base, catalogue: Sequence[Effect], tried: set[str], trouble: Sequence[Trouble]
) -> dict[str, str]:
    reasons = {t.name: t.reason for t in trouble}
    for effect in catalogue:
        if effect.name not in tried:
            reasons.setdefault(effect.name, f"it is part of {base.model.name}")
    return reasons


def _facts(truth: Truth, rng: np.random.Generator) -> Facts:
    """What the injected effects are built from: one instant, one mains line."""
    base, t, run = truth.base, truth.columns["t_s"], truth.columns["run"]
    warm = truth.columns.get("temperature_degc")
    middle = truth.runs[len(truth.runs) // 3 : max(2 * len(truth.runs) // 3, len(truth.runs) // 3 + 1)]
    inside = np.flatnonzero(run == rng.choice(middle))
    when = inside[0] if len(truth.runs) >= MANY else inside[len(inside) // 2]
    slip = (int(rng.integers(len(base.model.channels))), float(t[when] - t[0]))
    gains = tuple(
        float(base.p[base.model.names.index(n)]) if n in base.model.names else 1.0
        for n in (f"eta_{p.label}" for p in base.model.layout)
    )
    return Facts(
        duration_s=max(float(t[-1] - t[0]), 1e-6),
        step_s=float(np.median(np.diff(t))),
        columns=base.log.columns,
        temperature=None if warm is None else float(warm.mean()),
        extremes=np.quantile(truth.clean, [0.97, 0.03], axis=1),
        lines_hz=(HUM_HZ,),
        instants=(slip,),
        gains=gains,
    )


def _effect(
    truth: Truth,
    effect: Effect,
    variant: Variant,
    model: Model,
    new: Sequence[str],
    raw: np.ndarray,
    rng: np.random.Generator,
) -> Injection | None:
    """All new parameters at once, of random sign; those of one unit are about equal."""
    base = truth.base
    lower, upper = (b[[model.names.index(n) for n in new]] for b in model.bounds)
    units = [model.parameters[model.names.index(n)].unit for n in new]
    reach, each = np.maximum(np.abs(lower), np.abs(upper)), np.zeros(len(new))
    for unit in set(units):
        same = np.array([u == unit for u in units])
        total = float(np.sqrt((raw[same] ** 2).sum()))
        if total * reach[same].max() > SEEN * truth.floor_m:
            each[same] = truth.floor_m / total
    each[raw == 0.0] = 0.0  # what shows nowhere by itself, such as the width of a loop, stays
    draw = rng.uniform(0.5, 1.0, len(new)) * rng.choice([-1.0, 1.0], len(new))
    direction = each * np.where(lower >= 0, np.abs(draw), draw)
    if not np.any(direction):
        return None
    at = [model.names.index(n) for n in new]
    start = model.vector(dict(zip(base.model.names, base.p.tolist(), strict=True)))

    def make(amount: float, noise: Noisy) -> np.ndarray:
        p = start.copy()
        p[at] += amount * direction
        return readings_of(base, model, p) + noise

    def size(amount: float) -> Size:
        return {n: (float(amount * d), u) for n, d, u in zip(new, direction, units, strict=True) if d}

    moved = np.abs(direction) > 0
    limit = np.where(direction > 0, upper, -lower)[moved] / np.abs(direction[moved])
    return Injection(effect.name, effect.link, variant.label, make, size, float(limit.min()))


def _rails(truth: Truth, effect: Effect) -> Injection:
    """Hard clipping; the amount is the share of the samples beyond the rail of each probe."""
    channels = truth.base.model.channels

    def levels(share: float) -> np.ndarray:
        return np.quantile(np.abs(truth.clean), 1 - share, axis=1)

    def make(amount: float, noise: Noisy) -> np.ndarray:
        rail = levels(amount)[:, None]
        return np.clip(truth.clean + noise, -rail, rail)

    def size(amount: float) -> Size:
        return {f"rail_{c}": (float(v), _unit(truth)) for c, v in zip(channels, levels(amount), strict=True)}

    return Injection(effect.name, effect.link, "both rails, hard", make, size, MOST_SHARE, 0.03)


def _faults(truth: Truth, rng_of: Callable[[str], np.random.Generator]) -> list[Injection]:
    """Faults of samples, and of the wiring where there are wires."""
    clean, speed = truth.clean, truth.speed
    K, n = clean.shape
    level = float(np.sqrt(np.diag(truth.base.covariance).mean()))
    step = float(np.median(np.diff(truth.columns["t_s"])))
    spikes = rng_of("outliers")
    hit = (spikes.random((K, n)) < OUTLIERS) * spikes.choice([-1.0, 1.0], (K, n))
    old = rng_of("dropped_samples").random((n,))
    length = rng_of("dropped").integers(1, 1 + HOLD, (n,))
    shift = rng_of("clock_jitter").standard_normal((n,))

    def stale(amount: float, noise: Noisy) -> np.ndarray:
        return clean - speed * step * _ages(old < amount, length, truth.columns["run"]) + noise

    def adc(amount: float, noise: Noisy) -> np.ndarray:
        return np.round((clean + noise) / amount) * amount

    def one(name: str, unit: str) -> Callable[[float], Size]:
        return lambda amount: {name: (amount, unit)}

    unit, most = _unit(truth), 1e-2 if _unit(truth) == "m" else 1.0
    return [
        Injection("outliers", "electronics", f"{100 * OUTLIERS:g} % of the samples",
                  lambda amount, noise: clean + noise + amount * hit, one("spike", unit), most, 10 * level),
        Injection("dropped_samples", "clock", f"held for 1 to {HOLD} samples", stale, one("share", "1"),
                  MOST_SHARE, 0.01),
        Injection("clock_jitter", "clock", "rms of the sampling instants",
                  lambda amount, noise: clean + noise + amount * speed * shift, one("jitter", "s"),
                  10 * step, 0.1 * step),
        Injection("adc_quantisation", "electronics", "one step for all channels", adc, one("step", unit),
                  most / 10, 3 * level),
        *([_chip(truth)] if _goes_round(truth) else _wiring(truth, rng_of)),
    ]  # fmt: skip


def _chip(truth: Truth) -> Injection:
    """An angle computed with whole steps of CORDIC; the amount is its largest error [rad]."""

    def steps(amount: float) -> int:
        """The number whose error is nearest, by ratio."""
        known = range(FEWEST_STEPS, MOST_STEPS + 1)
        return min(known, key=lambda n: abs(float(np.log(worst_of(n) / amount))))

    def make(amount: float, noise: Noisy) -> np.ndarray:
        angle = truth.clean + noise
        return angle + wrapped(cordic_angle(np.sin(angle), np.cos(angle), steps(amount)) - angle, 2 * np.pi)

    def size(amount: float) -> Size:
        return {"steps": (float(steps(amount)), "1"), "error_at_most": (worst_of(steps(amount)), "rad")}

    start = float(np.sqrt(np.diag(truth.base.covariance).mean()))
    most = worst_of(FEWEST_STEPS)
    return Injection("cordic_steps", "electronics", "whole steps", make, size, most, 2 * start)


def _wiring(truth: Truth, rng_of: Callable[[str], np.random.Generator]) -> list[Injection]:
    """Two channels swapped, and one inverted."""
    clean, channels = truth.clean, truth.base.model.channels
    wires = rng_of("wiring")
    a, b = np.sort(wires.choice(len(clean), 2, replace=False)).tolist()
    flipped = int(wires.integers(len(clean)))

    def swap(_: float, noise: Noisy) -> np.ndarray:
        out = clean + noise
        out[[a, b]] = out[[b, a]]
        return out

    def invert(_: float, noise: Noisy) -> np.ndarray:
        out = clean + noise
        out[flipped] *= -1
        return out

    return [
        Injection("channel_swap", "electronics", f"{channels[a]} and {channels[b]}", swap, lambda _: {}, 1.0,
                  sized=False),
        Injection("sign_inversion", "electronics", channels[flipped], invert, lambda _: {}, 1.0,
                  sized=False),
    ]  # fmt: skip


def _ages(begins: np.ndarray, length: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Age in samples of each reading: 0 fresh; after a begin it grows until the hold ends."""
    age = np.zeros(len(begins))
    for k in np.flatnonzero(begins):
        n = int(length[k])
        last = min(int(k) + n, len(age))
        aged = np.arange(1, n + 1)[: last - int(k)]
        age[k:last] = np.where(run[k:last] == run[k], aged, age[k:last])
    return age


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """Return a generator that depends on the names only, so that leaving effects out changes no draw."""
    return np.random.default_rng([seed, *(crc32(str(n).encode()) for n in names)])
