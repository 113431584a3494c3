"""One flexible effect, or a plain one and a second: what explains more with fewer parameters goes first.

Real machines have small imperfections of every kind. An effect with many parameters may take some of them
along and so explain more than the plain cause does; but then the plain cause and one of those imperfections
explain as much together, with no more parameters.
"""

from collections.abc import Sequence

import numpy as np

from hallsym.diagnosis.effect import Effect, Facts
from hallsym.diagnosis.ranking import CLOSE, Exact
from hallsym.diagnosis.scores import candidates, scores

MOST = 2
"""Plain effects that are looked at."""


def plain_pairs(
    exact: list[Exact], catalogue: Sequence[Effect], runs: Sequence[int], facts: Facts, inflation: float
) -> list[Exact]:
    """Put a plain effect first if it and a second explain more than the flexible best one, by BIC."""
    if not exact:
        return exact
    best = exact[0]
    plain = [
        e for e in exact[1:] if e.score.size < best.score.size and e.score.gain >= CLOSE * best.score.gain
    ]
    found: list[tuple[float, Exact]] = []
    for e in plain[:MOST]:
        base = e.fit.base
        tried, _ = candidates(base, catalogue, facts)
        ranked, _ = scores(base, tried, runs, inflation)
        second = next((s for s in ranked if not s.absorbed), None)
        if second is None:
            continue
        N = float(e.fit.tangents.count[e.fit.fitted].sum()) * len(base.model.channels)
        both = second.bic + e.score.size * float(np.log(max(N / inflation, 2.0)))
        if second.size + e.score.size <= best.score.size and both < best.bic:
            found.append((both, e))
    if not found:
        return exact
    first = min(found, key=lambda f: f[0])[1]
    return [first, *(e for e in exact if e is not first)]
