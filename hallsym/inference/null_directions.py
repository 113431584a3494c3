"""Null directions: which parameters cannot be told apart, and which combinations of them are identifiable."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.estimation import CombinationEstimate, Cost, Determination, feature_scale, structural_null
from hallsym.estimation.identifiable import MOVING, echelon

NAMED = 0.05
"""Parameters that move less than this part of the leading one along a direction that a recording leaves are
not named with it. A structural direction names all that move: none of them is determined."""


WIDE = 4
"""Parameters of one direction above which what is determined of them is not said in a sentence."""


@dataclass(frozen=True)
class NullDirection:
    """One direction that is not determined: its parameters, and what of them is, if anything.

    `determined`: a combination that is determined although these parameters are not, with `value`, `std` and
    `unit`; None when nothing of them is. `also`: further ones.
    """

    parameters: tuple[str, ...]
    determined: str | None
    value: float | None
    std: float | None
    unit: str | None
    also: tuple[str, ...] = ()

    @property
    def is_wide(self) -> bool:
        """Whether so many parameters change together that what is determined of them takes a table."""
        return len(self.parameters) > WIDE and bool(self.also)


@dataclass(frozen=True)
class NullSpace:
    """`rank` of `of` directions are determined; `null` names the others that belong here."""

    rank: int
    of: int
    null: tuple[NullDirection, ...]


def structural(cost: Cost, found: Determination, combinations: Sequence[CombinationEstimate]) -> NullSpace:
    """Return the directions no recording determines.

    Their parameters are read off at a point anywhere in the bounds: at the optimum itself an angle near zero
    would hide that a parameter belongs.
    """
    model = cost.summary.model
    open_ = np.array([p.width > 0 for p in model.parameters])
    null = structural_null(cost.coefficients, feature_scale(cost), None, open_)
    of = int(open_.sum())
    return NullSpace(of - found.n_structural, of, _named(null, model.names, combinations, MOVING))


def practical(cost: Cost, found: Determination, combinations: Sequence[CombinationEstimate]) -> NullSpace:
    """Return the directions that this recording leaves undetermined, beyond the structural ones."""
    model = cost.summary.model
    of = sum(p.width > 0 for p in model.parameters)
    null = found.null[:, found.n_structural :]
    return NullSpace(of - found.null.shape[1], of, _named(null, model.names, combinations, NAMED))


def _named(
    null: np.ndarray, names: Sequence[str], combinations: Sequence[CombinationEstimate], least: float
) -> tuple[NullDirection, ...]:
    """Sparse directions that span the columns of `null`, in the order of their first parameter.

    `least`: part of the leading parameter's motion from which on another one is named.
    """
    if null.shape[1] == 0:
        return ()
    out = []
    for row in echelon(null.T):
        involved = tuple(names[k] for k in np.flatnonzero(np.abs(row) > least * np.abs(row).max()).tolist())
        telling = [c for c in combinations if mentions(c.expression, involved)]
        first = telling[0] if telling else None
        out.append(
            NullDirection(
                parameters=involved,
                determined=first.expression if first else None,
                value=first.value if first else None,
                std=first.std if first else None,
                unit=first.unit if first else None,
                also=tuple(c.expression for c in telling[1:]),
            )
        )
    return tuple(sorted(out, key=lambda d: list(names).index(d.parameters[0])))


def mentions(expression: str, parameters: Sequence[str]) -> bool:
    """Return whether an expression holds one of some parameters."""
    return bool(set(re.findall(r"[A-Za-z_]\w*", expression)) & set(parameters))
