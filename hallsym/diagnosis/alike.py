"""Effects that a log cannot tell apart, those that it does not exclude, and those that do little on it."""

from collections.abc import Sequence
from typing import Any

from hallsym.diagnosis.ranking import Exact, distance
from hallsym.diagnosis.record import FoundEffect, Separation
from hallsym.diagnosis.scores import by_name
from hallsym.diagnosis.search import Found, Search
from hallsym.diagnosis.separate import separation

APART = 25.0
"""Squared distance of two fits at which they are told apart, in variances of a slow average: 5 sigma."""
REASON = 20.0
"""Difference of BIC from which on parameters that are not needed tell an effect from a plainer one."""
SMALL = 0.01
"""Significance, corrected for the catalogue, of a smaller finding."""
SMALLEST = 0.1
"""Part of the threshold from which on a smaller finding is listed; with many samples anything is significant,
such as the noise of the reference that its rates and the residual share."""


def groups_of(search: Search, inflation: float) -> tuple[list[tuple[str, ...]], list[Separation]]:
    """Return the effects that this log cannot tell apart: refits that leave the same residual."""
    groups, separate = [], []
    for found in search.found:
        one = found.exact
        limit = _limit(one, inflation)
        rivals = _standing(found, inflation)
        if one.fit.base.model.family.pairs:  # parameters for which the log gives no reason make no rival
            rivals = [r for r in rivals if r.bic - one.bic < REASON]
        close = [(r, distance(one.fit, r.fit)) for r in rivals]
        close = [(r, d) for r, d in close if d < limit][:3]
        if not close:
            continue
        names = (one.score.effect.name, *(r.score.effect.name for r, _ in close))
        groups.append(names)
        least = min(d for _, d in close)
        members = (one, *(r for r, _ in close))
        separate.append(
            separation(
                names,
                [one.fit, *(r.fit for r, _ in close)],
                least,
                limit / APART,
                ways([e.score.effect.separate for e in members]),
            )
        )
    return groups, separate


def ways(records: Sequence[str]) -> str:
    """Return what the members of a group ask to be recorded, each way once with all that it would show.

    >>> ways(["another air gap; or a longer run", "another air gap: it follows the field"])
    'another air gap: it follows the field; or a longer run'
    """
    reasons: dict[str, dict[str, None]] = {}
    for way in (way for record in records for way in record.split("; or ")):
        what, _, reason = way.partition(": ")
        reasons.setdefault(what, {}).update({reason: None} if reason else {})
    return "; or ".join(f"{what}: {', '.join(why)}" if why else what for what, why in reasons.items())


def ranked_names(
    effects: Sequence[FoundEffect],
    groups: Sequence[tuple[str, ...]],
    search: Search,
    verdict: str,
    inflation: float,
) -> list[str]:
    """Return names that carry evidence: effects by share, what is the same on this log, what is not excluded.

    An effect that does not lower the gap on the held-out runs has none.
    """
    rivals = [
        r.score.effect.name for f in search.found for r in _standing(f, inflation) if verdict == "explained"
    ]
    grouped = [name for group in groups for name in group]
    return list(dict.fromkeys([*(e.name for e in effects if e.share > 0), *grouped, *rivals]))


def smaller_findings(search: Search) -> list[dict[str, Any]]:
    """Return effects that are significant beside what was found and worth less than the threshold."""
    out, tested = [], search.tested
    names = {f.exact.score.effect.name for f in search.found}
    for score in by_name(search.last):
        p = score.corrected(tested)
        # what is worth more was judged, and not taken
        small = SMALLEST * search.level <= 1 - score.ratio < search.level
        if p < SMALL and small and score.effect.name not in names:
            out.append({"name": score.effect.name, "shrinkage": 1 - score.ratio, "p_value": p})
    return out


def _limit(one: Exact, inflation: float) -> float:
    """Squares by which two fits must differ to be told apart."""
    N = float(one.fit.tangents.count[one.fit.fitted].sum()) * len(one.fit.base.model.channels)
    return APART * max(one.fit.cost / N, 1e-12) * inflation


def _standing(found: Found, inflation: float) -> list[Exact]:
    """Effects that the log does not exclude in the place of the one that was found."""
    limit = _limit(found.exact, inflation)
    return [r for r in found.rivals if r.fit.cost - found.exact.fit.cost < limit]
