"""A verdict in words for each parameter: what these data say of it, and why not more."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.estimation import coverage_factor
from hallsym.inference.evidence import Evidence
from hallsym.inference.null_directions import NullDirection, NullSpace, mentions

VERDICTS = ("determined", "weak", "at bound", "not determined", "no effect", "fixed")
WEAK = 1 / 3
"""A 95 % interval wider than this part of the bounds makes a parameter weak."""
WEAK_ALONE = 0.25
"""The same for a parameter without finite bounds: standard uncertainty over value."""
TRADED = 0.7
"""Correlation from which a parameter counts as traded off against another."""


@dataclass(frozen=True)
class Verdict:
    """`word` is one of `VERDICTS`; `because` says why, in a few words, where that needs saying."""

    word: str
    because: str = ""


def verdicts(
    evidence: Evidence, structural: NullSpace, practical: NullSpace, correlation: np.ndarray
) -> list[Verdict]:
    """Return one verdict per parameter; `correlation` is (n, n), nan where there is none."""
    idle = _idle(evidence)
    return [
        _verdict(evidence, k, bool(idle[k]), structural, practical, correlation[k])
        for k in range(len(evidence.p))
    ]


def _idle(evidence: Evidence) -> np.ndarray:
    """Which parameters may cross their whole bounds without a visible trace in these readings."""
    return np.diag(evidence.information) * evidence.found.scale**2 < 1.0


def _verdict(
    evidence: Evidence,
    k: int,
    idle: bool,
    structural: NullSpace,
    practical: NullSpace,
    correlation: np.ndarray,
) -> Verdict:
    parameter, names, told = evidence.model.parameters[k], evidence.model.names, evidence.uncertainty
    if parameter.width == 0:
        return Verdict("fixed")
    if parameter.name in told.at_bound:
        return Verdict("at bound", _bound(evidence, k))
    shared = [d for d in structural.null if parameter.name in d.parameters]
    if shared and not told.determined[k]:
        word = "not determined" if len(shared[0].parameters) > 1 else "no effect"
        return Verdict(word, _instead(parameter.name, *shared))
    if idle:
        return Verdict("no effect", "its whole range leaves no trace in these readings")
    if not told.determined[k]:
        lost = [d for d in practical.null if parameter.name in d.parameters]
        cause = "by this recording" if practical.null else "by any recording"
        return Verdict("not determined", _instead(parameter.name, *lost, cause=cause))
    half = float(coverage_factor(told.degrees_of_freedom[k])) * told.std[k]
    share = 2 * half / parameter.width if np.isfinite(parameter.width) else 0.0
    alone = told.std[k] / abs(evidence.p[k]) if not share and evidence.p[k] else 0.0
    if share > WEAK or alone > WEAK_ALONE:
        traded = [f"{n} (r = {r:+.2f})" for n, r in strongest(correlation, names, k) if abs(r) > TRADED]
        spans = f"its interval spans {100 * share:.0f} % of its bounds"
        return Verdict("weak", f"traded off against {', '.join(traded)}" if traded else spans)
    return Verdict("determined")


def strongest(
    correlation: np.ndarray, names: Sequence[str], k: int, most: int = 3
) -> list[tuple[str, float]]:
    """Return the parameters whose estimates are most correlated with parameter k, largest first."""
    size = np.abs(np.where(np.isfinite(correlation), correlation, 0.0))
    size[k] = 0.0
    order = [int(j) for j in np.argsort(-size, kind="stable") if size[j] > 0][:most]
    return [(names[j], float(correlation[j])) for j in order]


def _bound(evidence: Evidence, k: int) -> str:
    p = evidence.model.parameters[k]
    side = "lower" if abs(evidence.p[k] - p.lower) < abs(p.upper - evidence.p[k]) else "upper"
    return f"the data pull it to its {side} bound {getattr(p, side):g} {p.unit}"


def _instead(name: str, *directions: NullDirection, cause: str = "by any recording") -> str:
    """What is determined in the place of a parameter that is not, or what it may change together with."""
    wide = next((d for d in directions if d.is_wide), None)
    if wide is not None:
        first, second, *more = (n for n in wide.parameters if n != name)
        return f"{cause}; it may change together with {first}, {second} and {len(more)} more"
    every = [text for d in directions if d.determined for text in (d.determined, *d.also)]
    told = [text for text in every if mentions(text, (name,))] or every
    if told:
        return f"{cause}; only {_listed(dict.fromkeys(told))} determined"
    alone = all(len(d.parameters) == 1 for d in directions)
    return cause if alone else f"{cause}, nor a combination of it"


def _listed(expressions: Iterable[str]) -> str:
    *first, last = expressions
    return f"{', '.join(first)} and {last} are" if first else f"{last} is"
