"""Which of the effects that were found hold on the held-out runs, each with all others in place."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hallsym.diagnosis.chance import beyond
from hallsym.diagnosis.errors import BlockErrors, block_errors, interval
from hallsym.diagnosis.refit import Refitted
from hallsym.diagnosis.search import Found, Search
from hallsym.turning import designed

BENT = 0.5
"""Part of what the first order leaves below which an exact refit has explained something else.

The score of such an effect says how well its tangent fits, not whether the effect is there."""
OVER = 2.0
"""Times the whole deviation of the machine from its design by which an effect alone may move the pose.

Effects of a kind with the model's own parameters, or with each other, can grow without end as long as they
cancel; the small difference then fits anything. Causes that happen to oppose each other may make one of them
larger than the whole, hardly twice."""


@dataclass(frozen=True, eq=False)
class Held:
    """An effect with the fit `without` it, the `errors` of that fit on the held-out runs, and `p_value`."""

    found: Found
    without: Refitted
    errors: BlockErrors
    p_value: float


def held(
    search: Search, before: BlockErrors, apart: Sequence[int], rows: int
) -> tuple[list[dict[str, Any]], list[str]]:
    """Take out of `search` what does not hold on the runs `apart`; return smaller findings, and notes.

    An effect holds if the 95 % interval of its shrinkage lies above 0 and it is not undone by others. The
    weakest goes first, since of two that resemble each other one may be needed. `before`: errors without any.
    """
    out, notes = [], []
    start = search.start.base
    design = replace(start, p=designed(start.model, start.p), keep=None)
    limit = OVER * max(block_errors(design, apart, rows, None).metric, before.metric)
    while search.found:
        after = block_errors(replace(search.now.base, keep=None), apart, rows, None)
        weak = []
        for h in holding(search, before, after, apart, rows):
            alone = _alone(search, h, apart, rows)
            if interval(h.errors, after)[0] <= 0 or alone > limit:
                weak.append((1 - after.metric / h.errors.metric, alone, h))
        if not weak:
            break
        shrinkage, alone, worst = min(weak, key=lambda w: w[0])
        name = worst.found.exact.score.effect.name
        if shrinkage > 0:
            out.append({"name": name, "shrinkage": shrinkage, "p_value": worst.p_value})
        if alone > limit:
            notes.append(
                f"{name} is not named: alone it would make {OVER * alone / limit:.2g} x all that the machine "
                "deviates by, and is undone by the other parameters."
            )
        search.found = [f for f in search.found if f is not worst.found]
        search.now = worst.without
    return out, notes


def _alone(search: Search, held: Held, apart: Sequence[int], rows: int) -> float:
    """Gap metric that is left if one effect is taken away and all else stays where it is."""
    now, known = search.now.base, held.without.base.model.names
    p = np.where([n in known for n in now.model.names], now.p, now.model.nominal)
    return block_errors(replace(now, p=p, keep=None), apart, rows, None).metric


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
