"""Which of the effects that were found hold on the held-out runs, each with all others in place."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hallsym.diagnosis.decoded_errors import BlockErrors, block_errors, interval
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.refit import Refitted
from hallsym.diagnosis.search import Found, Search

BENT = 0.5
"""Part of what the first order leaves below which an exact refit has explained something else.

The score of such an effect says how well its tangent fits, not whether the effect is there."""


@dataclass(frozen=True, eq=False)
class Held:
    """An effect with the fit `without` it, the `errors` of that fit on the held-out runs, and `p_value`."""

    found: Found
    without: Refitted
    errors: BlockErrors
    p_value: float


def held(search: Search, before: BlockErrors, apart: Sequence[int], rows: int) -> list[dict[str, Any]]:
    """Take out of `search` what does not hold on the runs `apart`; return what lowers the gap, as findings.

    An effect holds if the 95 % interval of its shrinkage lies above 0. The weakest goes first, since two that
    resemble each other may both be dispensable and one of them be needed. `before`: errors without any.
    """
    out = []
    while search.found:
        after = block_errors(replace(search.now.base, keep=None), apart, rows, None)
        judged = holding(search, before, after, apart, rows)
        weak = [(1 - after.metric / h.errors.metric, h) for h in judged if interval(h.errors, after)[0] <= 0]
        if not weak:
            break
        shrinkage, worst = min(weak, key=lambda w: w[0])
        score = worst.found.exact.score
        if shrinkage > 0:
            out.append({"name": score.effect.name, "shrinkage": shrinkage, "p_value": worst.p_value})
        search.found = [f for f in search.found if f is not worst.found]
        search.now = worst.without
    return out


def holding(
    search: Search, before: BlockErrors, after: BlockErrors, apart: Sequence[int], rows: int
) -> list[Held]:
    """Return each effect that was found beside the fit without it; `after`: errors with all of them."""
    out = []
    for k, found in enumerate(search.found):
        others = [f.exact for j, f in enumerate(search.found) if j != k]
        without = search.rebuilt(others) if others else search.start
        errors = block_errors(replace(without.base, keep=None), apart, rows, None) if others else before
        p = found.exact.score.corrected(search.tested)
        if found.left < BENT * found.first_order:
            p = min(1.0, shrinks(errors, after) * search.tested)
        out.append(Held(found, without, errors, p))
    return out


def shrinks(before: BlockErrors, after: BlockErrors) -> float:
    """Return the p-value of no decrease: the logarithms of the blocks' ratios, by Student's t.

    The held-out runs took no part in choosing or fitting, so nothing that was tried there is to be corrected.
    """
    a, b = before.sums, after.sums
    if len(a) != len(b):
        return 1.0
    seen = (a > 0) & (b > 0)
    return beyond(np.log(a[seen] / b[seen]))
