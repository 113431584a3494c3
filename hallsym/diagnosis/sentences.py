"""Sentences of a diagnosis, and the command that comes next."""

from collections.abc import Sequence

from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.record import FoundEffect, Metric
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.validation import Validation
from hallsym.diagnosis.words import gap_text
from hallsym.estimation.calibration import added_effects


def sentence(
    verdict: str,
    effects: Sequence[FoundEffect],
    groups: Sequence[tuple[str, ...]],
    gap: Metric,
    unit: tuple[float, str],
) -> str:
    """Return the diagnosis in one or two sentences; gaps in `unit`, the factor and name a person reads."""
    before, after, floor = (gap_text(v, unit) for v in (gap.before, gap.after, gap.floor))
    if verdict == "no gap":
        small = gap.before <= gap.floor * (1 + POLICY.floor_known)
        alone = f"noise alone gives {floor}"
        return f"No gap. The error on the holdout runs is {before}; {alone}" + (
            "." if small else ", and the difference is not worth reporting."
        )
    times = gap.before / max(gap.floor, 1e-300)
    said = f"The error on the holdout runs is {before}, {times:.3g} x the noise floor"
    if not effects:
        return f"{said}; no known effect explains it."
    named = " and ".join(_with_group(e.name, groups) for e in effects)
    rest = "" if verdict == "explained" else "; the rest has no known cause"
    return f"{said}. With {named} it falls to {after}{rest}."


def _with_group(name: str, groups: Sequence[tuple[str, ...]]) -> str:
    """Return an effect with the others that the log cannot tell from it: `time_skew (or first_order_lag)`."""
    group = next((g for g in groups if name in g), (name,))
    others = [other for other in group if other != name]
    return f"{name} (or {' or '.join(others)})" if others else name


def floor_lowered_text(times: float) -> str:
    """Return what to say of a noise floor that was estimated too high."""
    return (
        f"The estimated noise was {times:.3g} x the error with the effects found: a pattern from sample to "
        "sample was taken for noise. That error serves as the noise floor; state the noise (--noise) if you "
        "know it."
    )


def shapeless_text(times: float, stated: bool) -> str:
    """Return what to say of noise that is larger than stated or estimated."""
    return (
        f"The error is {times:.3g} x the {'stated' if stated else 'estimated'} noise and depends on nothing "
        "that the log holds: the noise is larger than that, or more correlated in time."
    )


def at_bound_text(names: Sequence[str]) -> str:
    """Return what to say of parameters that ended at a bound."""
    bound = "its bound" if len(names) == 1 else "their bounds"
    return (
        f"{', '.join(names)} ended at {bound}, so there is no interval; the intervals of other parameters "
        "hold only if the bound is right. Either the bound is wrong for this machine, or another effect does "
        "part of the work."
    )


def unseen_text(names: Sequence[str]) -> str:
    """Return what to say of parameters on which no sample depends."""
    return f"No sample of this log depends on {', '.join(names)}: fixed at the nominal value."


def next_step(setup: Setup, found: Validation) -> tuple[str, ...]:
    """Return the arguments of `hallsym fit LOG` that fit the model with the effects found, in their order.

    The pieces of a split recording are no runs of the log on disk, so they are not held out.
    """
    variants = [e.selected.exact.score.variant for e in found.effects]
    texts = [v.text for v in variants if v.text]
    if not texts:
        return ()
    model = setup.fit.model
    words = ["--model", model.name]
    for text in (*added_effects(model), *texts):
        words += ["--effect", text]
    if not setup.split:
        words += ["--holdout", ",".join(map(str, setup.holdout))]
    return (*words, *(["--resolve-wiring"] if setup.miswired else []))
