"""What can be injected into a log: the effects of a catalogue through their own models, and the faults."""

from collections.abc import Callable, Sequence

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.effect import Effect, Facts, Variant
from hallsym.diagnosis.injection import Injection, Noisy, Size
from hallsym.diagnosis.injection_faults import faults, rails
from hallsym.diagnosis.normal_equations import tangents
from hallsym.diagnosis.scores import Trouble, candidates
from hallsym.diagnosis.simulated_machine import Truth, goes_round, readings_of
from hallsym.model import Model

HUM_HZ = 50.03
"""Mains frequency of the simulated pick-up: mains are never at 50 Hz exactly."""
SEEN = 1e-3
"""A parameter that makes less than this part of the noise floor at its bound is left at 0."""
MANY = 10
"""Fitted runs from which on a probe slips between two of them and not within one."""


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
            if goes_round(truth):
                reasons[effect.name] = "an angle has no rails; the voltages are not logged"
            else:
                out.append(rails(truth, effect))
            continue
        raw = np.sqrt(np.maximum(strength[t.span[key]], 0.0))
        made = _effect(truth, effect, variant, model, new, raw, rng_of(effect.name))
        if made is None:
            reasons[effect.name] = "this log has no motion that would show it"
        else:
            out.append(made)
    if goes_round(truth):
        reasons |= dict.fromkeys(("channel_swap", "sign_inversion"), "one channel has no wires to mix up")
    else:
        reasons["cordic_steps"] = "the readings are no angles"
    return out + faults(truth, rng_of), reasons


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
