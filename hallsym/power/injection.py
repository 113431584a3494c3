"""Readings of a machine with a known gap: an effect or fault, scaled to the wanted gap.

An effect acts through its own model, exactly; a fault of samples acts on the readings
(`hallsym.families.faults`).
"""

from collections.abc import Sequence
from dataclasses import replace
from zlib import crc32

import numpy as np
from scipy.optimize import brentq

from hallsym.diagnosis.normal_equations import normal_equations
from hallsym.diagnosis.scores import Candidate, candidates
from hallsym.diagnosis.words import gap_text, gap_unit
from hallsym.families.faults import FAULTS, Draw, Injection, Noisy, RecordingFault, Size
from hallsym.model import Effect, Facts
from hallsym.model.arguments import example_facts
from hallsym.power.simulated_machine import SimulatedMachine, readings_of


def sized(truth: SimulatedMachine, injection: Injection, ratio: float) -> tuple[float, float] | str:
    """Return the amount whose noise-free gap with the floor is `ratio` times the floor, and its gap metric.

    Or the reason why there is none.
    """
    wanted, near = truth.floor_m * float(np.sqrt(ratio**2 - 1)), truth.base.policy.negligible
    tiny, seen = np.finfo(float).eps, dict[float, tuple[float, float]]()

    def over(level: float) -> float:
        """Logarithm of the gap over the wanted one; `level`: logarithm of the amount."""
        if level not in seen:
            readings = injection.make(float(np.exp(level)), 0.0)
            finite = bool(np.isfinite(readings).all())
            seen[level] = truth.gap(readings) if finite else (np.inf, np.inf)
        return float(np.log(np.clip(seen[level][0] / wanted, tiny, 1 / tiny)))

    def absorbed(level: float) -> bool:
        gap, raw = seen[level]
        return gap < near * raw and truth.floor_m < raw

    most, step = float(np.log(injection.most)), float(np.log(10.0))
    low = high = min(float(np.log(injection.start)), most)
    while over(high) < 0 and high < most and not absorbed(high):
        low, high = high, min(high + step, most)
    while over(low) > 0 and low > most + np.log(tiny):
        high, low = low, low - step
    if over(low) < 0 < over(high):
        brentq(over, low, high, xtol=near)
    best = min(seen, key=lambda level: abs(over(level))) if over(high) > 0 else high
    gap, raw = seen[best]
    unit, reason = gap_unit(truth.base.model.pose), ""
    makes = f"makes {gap_text(gap, unit, 2)} on this log"
    if gap == np.inf:
        reason = "its readings are not finite on this log"
    elif absorbed(best):
        share = f"less than {100 * near:g} %"
        reason = f"the model's own parameters absorb it: of {gap_text(raw, unit)} they leave {share}"
    elif over(high) < -near:
        reason = f"at the bounds of its parameters it {makes}"
    elif abs(over(best)) > -np.log(truth.base.policy.half):
        reason = f"it comes in steps, the nearest of which {makes}"
    return reason or (float(np.exp(best)), gap)


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """Return a generator that depends on the names only, so that leaving effects out changes no draw."""
    return np.random.default_rng([seed, *(crc32(str(n).encode()) for n in names)])


# -- what can be injected ----------------------------------------------------------------------------------


def injections(
    truth: SimulatedMachine, catalogue: Sequence[Effect], draw: Draw
) -> tuple[dict[str, Injection], dict[str, str]]:
    """Return everything that can be injected into this log, by name, and why the others cannot."""
    base, recording = truth.base, truth.recording
    tried, reasons = candidates(base, catalogue, _facts(truth, draw("mount_slip")))
    t = normal_equations(base, {key: (c.model, c.new) for key, c in tried.items()})
    out: dict[str, Injection] = {}

    def add(known: Effect | RecordingFault, made: Injection | str) -> None:
        if isinstance(made, str):
            reasons[known.name] = made
        else:
            out[known.name] = replace(made, name=known.name, link=known.link)

    for effect in catalogue:
        variants = [key for key in tried if key.split("|")[0] == effect.name]
        own = [key for key in variants if key not in t.spoiled]
        if own and effect.inject:
            add(effect, effect.inject(recording, draw))
        elif own:
            gridded = any(effect.numbers[n].grid for n in tried[own[0]].variant.numbers)
            key = own[(len(own) - 1) // 2] if gridded else own[0]
            decoded = t.decoded.of(t.span[key], t.places[key]).sum(axis=0)
            squares = np.diag(decoded)[len(base.free) : -1] / t.count.sum()
            strength = np.sqrt(np.maximum(squares, 0.0))
            add(effect, _effect(truth, tried[key], strength, draw(effect.name)))
        elif not variants:
            reasons.setdefault(effect.name, f"it is part of {base.model.name}")
    for fault in FAULTS.values():
        add(fault, fault.inject(recording, draw))
    return out, reasons


def _facts(truth: SimulatedMachine, rng: np.random.Generator) -> Facts:
    """Facts for the injected effects: one instant, in the middle of a run, and one mains line."""
    base, t, run = truth.base, truth.columns["t_s"], truth.recording.run
    warm = truth.columns.get("temperature_degc")
    third = len(truth.runs) // 3
    inside = np.flatnonzero(run == rng.choice(truth.runs[third : max(2 * third, third + 1)]))
    when = float(t[inside[len(inside) // 2]] - t[0])
    slip = (int(rng.integers(len(base.model.channels))), when, when, when)
    return Facts(
        duration_s=max(float(t[-1] - t[0]), 1e-6),
        columns=base.log.columns,
        temperature=None if warm is None else float(warm.mean()),
        extremes=np.quantile(truth.recording.clean, [0.97, 0.03], axis=1),
        lines_hz=example_facts(base.model).lines_hz,
        instants=(slip,),
    )


def _effect(
    truth: SimulatedMachine, candidate: Candidate, raw: np.ndarray, rng: np.random.Generator
) -> Injection | str:
    """All new parameters at once, of random sign; those of one unit are about equal.

    `raw`: gap metric that each makes per unit of the parameter before anything is fitted, (n,).
    """
    base, model, new = truth.base, candidate.model, candidate.new
    at = [model.names.index(n) for n in new]
    lower, upper = (b[at] for b in model.bounds)
    units = [model.parameters[k].unit for k in at]
    reach, each = np.maximum(np.abs(lower), np.abs(upper)), np.zeros(len(new))
    for unit in set(units):
        same = np.array([u == unit for u in units]) & (raw > 0)  # the width of a loop has no effect by itself
        total = float(np.sqrt((raw[same] ** 2).sum()))
        if total * reach[same].max(initial=0.0) > base.policy.negligible * truth.floor_m:
            each[same] = truth.floor_m / total
    draw = rng.uniform(0.5, 1.0, len(new)) * rng.choice([-1.0, 1.0], len(new))
    direction = each * np.where(lower >= 0, np.abs(draw), draw)
    if not np.any(direction):
        return "this log has no motion that would show it"
    start = model.vector(base.values)

    def make(amount: float, noise: Noisy) -> np.ndarray:
        p = start.copy()
        p[at] += amount * direction
        return readings_of(base, model, p) + noise

    def size(amount: float) -> Size:
        return {n: (float(amount * d), u) for n, d, u in zip(new, direction, units, strict=True) if d}

    moved = np.abs(direction) > 0
    limit = np.where(direction > 0, upper, -lower)[moved] / np.abs(direction[moved])
    return Injection(candidate.variant.label, make, size, float(limit.min()))
