"""Readings of a machine whose gap is known: an effect or fault, scaled until the gap is as wanted.

An effect acts through its own model, exactly; a fault of samples acts on the readings
(`hallsym.families.faults`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.scores import candidates
from hallsym.diagnosis.simulated_machine import SimulatedMachine, goes_round, readings_of, unit_of
from hallsym.diagnosis.survey import FINE, MAINS
from hallsym.diagnosis.words import gap_text, gap_unit
from hallsym.families.faults import FAULTS, Draw, Injection, Noisy, Recording, RecordingFault, Size
from hallsym.model import Effect, Facts, Model, Variant

NEAR = 0.02
"""How near the gap of an injection must come to what is wanted; what the model's own parameters must leave of
an effect for it to count as visible."""
SEARCH = 12
SEEN = 1e-3
"""A parameter that makes less than this part of the noise floor at its bound is left at 0."""
MANY = 10
"""Fitted runs from which on a probe slips between two of them and not within one."""


@dataclass(frozen=True)
class Sized:
    """How large an injection must be for a gap: `reason` says why there is no such amount."""

    amount: float
    gap_m: float
    reason: str = ""


def sized(truth: SimulatedMachine, injection: Injection, ratio: float) -> Sized:
    """Scale an injection until its noise-free gap with the floor is `ratio` times the floor."""
    wanted = truth.floor_m * float(np.sqrt(ratio**2 - 1))
    amount, slope, seen = min(injection.start, injection.most), 1.0, [(0.0, 0.0)]
    for _ in range(SEARCH):
        readings = injection.make(amount, 0.0)
        if not np.isfinite(readings).all():
            return Sized(amount, 0.0, "its readings are not finite on this log")
        gap, raw = truth.gap(readings)
        hidden = gap < NEAR * raw and raw > truth.floor_m
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
    if gap < NEAR * raw:
        return f"the model's own parameters absorb it: of {gap_text(raw, unit)} they leave {left}"
    return f"at the bounds of its parameters it makes {left} on this log"


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """Return a generator that depends on the names only, so that leaving effects out changes no draw."""
    return np.random.default_rng([seed, *(crc32(str(n).encode()) for n in names)])


# -- what can be injected ----------------------------------------------------------------------------------


def injections(
    truth: SimulatedMachine, catalogue: Sequence[Effect], draw: Draw
) -> tuple[list[Injection], dict[str, str]]:
    """Return everything that can be injected into this log, and why the others cannot."""
    base = truth.base
    tried, trouble = candidates(base, catalogue, _facts(truth, draw("mount_slip")))
    t = normal_equations(base, {key: (model, new) for key, (_, _, model, new) in tried.items()})

    def strength(key: str) -> np.ndarray:
        squares = np.diag(t.of(key, decoded=True).sum(axis=0))[len(base.free) : -1]
        return np.sqrt(np.maximum(squares / t.count.sum(), 0.0))

    recording = _recording(truth)
    reasons = {t.name: t.reason for t in trouble}
    out = []

    def add(known: Effect | RecordingFault, made: Injection | str) -> None:
        if isinstance(made, str):
            reasons[known.name] = made
        else:
            out.append(replace(made, name=known.name, link=known.link))

    for effect in catalogue:
        variants = [key for key in tried if key.split("|")[0] == effect.name]
        own = [key for key in variants if key not in t.spoiled]
        if own and effect.inject:
            add(effect, effect.inject(recording, draw))
        elif own:
            gridded = effect.around(tried[own[0]][1]) is not None
            key = own[(len(own) - 1) // 2] if gridded else own[0]
            _, variant, model, new = tried[key]
            add(effect, _effect(truth, variant, model, new, strength(key), draw(effect.name)))
        elif not variants:
            reasons.setdefault(effect.name, f"it is part of {base.model.name}")
    for fault in FAULTS.values():
        add(fault, fault.inject(recording, draw))
    return out, reasons


def _recording(truth: SimulatedMachine) -> Recording:
    return Recording(
        channels=truth.base.model.channels,
        clean=truth.clean,
        speed=truth.speed,
        run=truth.columns["run"],
        step_s=float(np.median(np.diff(truth.columns["t_s"]))),
        sigma=float(np.sqrt(np.diag(truth.base.covariance).mean())),
        unit=unit_of(truth),
        decoded=goes_round(truth),
    )


def _facts(truth: SimulatedMachine, rng: np.random.Generator) -> Facts:
    """What the injected effects are built from: one instant, one mains line."""
    base, t, run = truth.base, truth.columns["t_s"], truth.columns["run"]
    warm = truth.columns.get("temperature_degc")
    middle = truth.runs[len(truth.runs) // 3 : max(2 * len(truth.runs) // 3, len(truth.runs) // 3 + 1)]
    inside = np.flatnonzero(run == rng.choice(middle))
    when = inside[0] if len(truth.runs) >= MANY else inside[len(inside) // 2]
    slip = (int(rng.integers(len(base.model.channels))), float(t[when] - t[0]))
    return Facts(
        duration_s=max(float(t[-1] - t[0]), 1e-6),
        columns=base.log.columns,
        temperature=None if warm is None else float(warm.mean()),
        extremes=np.quantile(truth.clean, [0.97, 0.03], axis=1),
        lines_hz=(MAINS[0] + FINE / 4,),  # on none of the frequencies that are tried first
        instants=(slip,),
    )


def _effect(
    truth: SimulatedMachine,
    variant: Variant,
    model: Model,
    new: Sequence[str],
    raw: np.ndarray,
    rng: np.random.Generator,
) -> Injection | str:
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
        return "this log has no motion that would show it"
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
    return Injection(variant.label, make, size, float(limit.min()))
