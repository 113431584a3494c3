"""Sentences of a diagnosis, and the command that it asks for next."""

from collections.abc import Sequence

from hallsym.diagnosis.record import FoundEffect
from hallsym.diagnosis.search import Search
from hallsym.diagnosis.verdict import ALLOWANCE
from hallsym.estimation.calibration import Fit, added_effects


def sentence(
    verdict: str,
    effects: Sequence[FoundEffect],
    groups: Sequence[tuple[str, ...]],
    before: float,
    left: float,
    floor: float,
    unit: tuple[float, str],
) -> str:
    """Return the diagnosis in one sentence; gaps in the unit of the pose, `unit`: how a person reads them."""
    size, name = unit
    times = before / max(floor, 1e-300)
    said = f"The gap on the held-out runs is {size * before:.3g} {name}, {times:.3g} x the noise floor"
    if verdict == "no gap":
        what = "is what noise leaves" if before <= floor * (1 + ALLOWANCE) else "holds no gap worth reporting"
        noise = f"{size * floor:.3g} {name}"
        return f"No gap: {size * before:.3g} {name} on the held-out runs {what} (noise: {noise})."
    if not effects:
        return f"{said}; no known effect explains it."
    named = " and ".join(next((" or ".join(g) for g in groups if e.name in g), e.name) for e in effects)
    rest = "" if verdict == "explained" else ", and the rest has no known cause"
    return f"{said}; {named} brings it to {size * left:.3g} {name}{rest}."


def noise_held_gap(times: float) -> str:
    """Return what to say of a noise floor that was estimated too high."""
    return (
        f"The noise was estimated {times:.3g} x as large as what is left: a pattern from sample to sample "
        "was counted as noise. What is left is taken as the floor; state the noise (--noise) where known."
    )


def shapeless(times: float, stated: bool) -> str:
    """Return what to say of noise that is more than it is said to be."""
    return (
        f"What is left is {times:.3g} x the {'stated' if stated else 'estimated'} noise and follows nothing "
        "that the log holds: the noise is larger, or more correlated in time, than that."
    )


def stuck_text(names: Sequence[str]) -> str:
    """Return what to say of parameters that ended at a bound."""
    ended = "its bound" if len(names) == 1 else "their bounds"
    return (
        f"{', '.join(names)} ended at {ended}: the data ask for more than is allowed; there is no interval, "
        "and those of the others hold only with it there. Either the bound is wrong for this machine, or "
        "another effect does part of the work."
    )


def blind_text(names: Sequence[str]) -> str:
    """Return what to say of parameters that no sample depends on."""
    return f"No sample of this log depends on {', '.join(names)}: held at the nominal value."


def next_step(
    result: Fit, effects: Sequence[FoundEffect], search: Search, apart: tuple[int, ...], wired: bool
) -> tuple[str, ...]:
    """Return what `hallsym fit LOG` takes to fit the model with the effects found, in their order."""
    named = {e.name for e in effects if e.text}
    texts = [f.exact.score.variant.text for f in search.found if f.exact.score.effect.name in named]
    if not texts:
        return ()
    words = ["--model", result.model.name]
    for text in (*added_effects(result.model), *texts):
        words += ["--effect", text]
    return (*words, "--holdout", ",".join(map(str, apart)), *(["--resolve-wiring"] if wired else []))
