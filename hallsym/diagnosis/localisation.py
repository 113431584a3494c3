"""Localisation of a gap: which share of the excess goes with a coordinate, a sensor, a frequency, a run.

Coordinates are taken one after the other, the one that explains most of what is still there first, so that
shares add up to at most the whole and nothing is said twice. Each share is counted on runs that the curve was
not fitted on; each p-value takes runs (or stretches of few runs) as blocks and counts how much was tried.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.coordinates import coordinates
from hallsym.diagnosis.curve_words import described
from hallsym.diagnosis.curves import Curve, FineMap, Smooth, predicted, run_gains
from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.links import of_links
from hallsym.diagnosis.p_values import beyond
from hallsym.diagnosis.record import Share, Statement
from hallsym.diagnosis.residual_table import ResidualTable, residual_table
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import Score
from hallsym.diagnosis.shares import (
    CERTAIN,
    LEAST,
    LEVEL,
    means,
    of_frequencies,
    of_powers,
    of_runs,
    outputs,
    sensors,
)
from hallsym.diagnosis.words import percent

LIKELY = 0.05
"""Significance that is enough for a coordinate that predicts what certainly differs from run to run."""
SMALL = 0.02
"""Excess over the noise [share of its power] below which nothing is said."""
MOST = 5
NEARLY = 0.92
"""Of coordinates that explain at least this part of what the best one explains the most telling is named."""
RATHER = 0.6
"""A gain of its own in every run is named only where no coordinate explains this part of what it does."""


@dataclass(frozen=True, eq=False)
class Located:
    """Statements on where an excess lies, what each place takes by itself, and what both rest on.

    `curves`: behind the statements on coordinates. `fitted`, `held`: the residual on fitted and on held-out
    runs, None where there are no samples.
    """

    statements: tuple[Statement, ...]
    curves: tuple[Curve, ...]
    fitted: ResidualTable | None
    held: ResidualTable | None = None
    shares: tuple[Share, ...] = ()


def both(base: Base, runs: Sequence[int]) -> tuple[ResidualTable | None, ResidualTable | None]:
    """Return the residual on those of `runs` that are fitted and on those that are held out."""
    apart = (False, True)
    fitted, held = (residual_table(base, [r for r in runs if (r in base.holdout) == held]) for held in apart)
    return fitted, held


def located(
    base: Base,
    runs: Sequence[int],
    scored: Sequence[Score] = (),
    faults: Sequence[Fault] = (),
    variance: float = 1.0,
) -> Located:
    """Return the statements with what they rest on.

    `scored`: the catalogue's effects at `base`, for the links of the chain. `faults`: of samples, their power
    as a part of `variance`, the whitened residual's.
    """
    fitted, held = both(base, runs)
    if fitted is None or fitted.excess <= SMALL * fitted.residual.size:
        return Located((), (), fitted, held)
    statements, curves, alone = _coordinates(fitted)
    if held is not None and held.excess > 0:
        statements = _confirmed(statements, curves, fitted, held)
    if not statements and not _clear(fitted):
        return Located((), tuple(curves), fitted, held)
    told = sum(s.share for s in statements)
    tones, frequencies = of_frequencies(fitted, told)
    if frequencies and frequencies[0].kind == "mains" and frequencies[0].share > told:
        statements, frequencies = [frequencies[0], *statements], frequencies[1:]
    size = variance * fitted.residual.size / fitted.excess
    bad = [replace(f, power=f.power * size) for f in faults]
    rest = [of_links(base, scored, fitted, bad)] if scored else []
    rest += [of_powers(p(fitted), fitted.block) for p in (outputs, sensors)]
    rest += [(tones, frequencies), of_runs(fitted, told)]
    said = [s for _, found in rest for s in found]
    shares = [*alone, *(row for rows, _ in rest for row in rows)]
    return Located((*statements, *said), tuple(curves), fitted, held, tuple(shares))


def _clear(r: ResidualTable) -> bool:
    """Whether the excess is more than chance: block by block, so that memory of the noise does not count."""
    return beyond(means(r.squares - len(r.residual), r.block)) < CERTAIN


# -- coordinates -------------------------------------------------------------------------------------------


def _coordinates(r: ResidualTable) -> tuple[list[Statement], list[Curve], list[Share]]:
    """Coordinates one after the other, each with what it explains beyond those before; and each by itself."""
    known = coordinates(r)
    every: list[Smooth | FineMap] = [Smooth(r, c) for c in known]
    every += [FineMap(r, c) for c in known if c.fine]
    tried = [t for t in every if t.values is not None]
    alone: list[Share] = []
    count, excess = len(tried) + 1, r.excess
    statements: list[Statement] = []
    curves: list[Curve] = []
    left = r.residual
    for _ in range(MOST):
        found = [c for t in tried if (c := t.curve(left)) is not None]
        run = _own_gain(r, left, excess, count)
        alone = alone or _alone(r, every, found, run, count)
        good = [c for c in found if c.p_value * count < LEVEL and c.explained > LEAST * excess]
        if run:  # a difference from run to run is certain; what predicts most of it on other runs is it
            most = RATHER * run.share * excess
            good += [c for c in found if LEVEL <= c.p_value * count < LIKELY and c.explained > most]
        best = max((c.explained for c in good), default=0.0)
        if run and RATHER * run.share * excess > best:
            statements.append(run)
            break
        if not good:
            break
        first = next(c for c in good if c.explained >= NEARLY * best)
        share = min(first.explained / excess, 1.0 - sum(s.share for s in statements))
        if share < LEAST:
            break
        statements.append(described(r, first, share, min(1.0, first.p_value * count), bool(statements)))
        curves.append(first)
        tried = [t for t in tried if t.coordinate.name != first.coordinate.name]
        left = left - first.predicted
    return statements, curves, alone


def _alone(
    r: ResidualTable,
    every: Sequence[Smooth | FineMap],
    found: Sequence[Curve],
    run: Statement | None,
    count: int,
) -> list[Share]:
    """What each coordinate explains with none before it; of a smooth curve and a fine map the better one."""
    out = []
    for c in dict.fromkeys(t.coordinate for t in every):
        own = [f for f in found if f.coordinate == c]
        if not own:
            logged = c.own or not c.ordered or c.column in r.columns
            out.append(
                Share("coordinate", c.name, None, None, "it does not move" if logged else "not logged")
            )
            continue
        share = max(float(np.clip(f.explained / r.excess, 0.0, 1.0)) for f in own)
        out.append(Share("coordinate", c.name, share, min(1.0, count * min(f.p_value for f in own))))
    if run:
        out.append(Share("run", run.at, run.share, run.p_value))
    return out


def _own_gain(r: ResidualTable, left: np.ndarray, excess: float, count: int) -> Statement | None:
    explained, p = run_gains(r, left)
    if p * count >= LEVEL or explained <= LEAST * excess:
        return None
    share = min(explained / excess, 1.0)
    text = f"{percent(share)} of the excess is a gain that differs from run to run and follows nothing logged"
    return Statement("run", "gain of its own", share, min(1.0, p * count), text, kind="run")


def _confirmed(
    statements: list[Statement], curves: list[Curve], fitted: ResidualTable, held: ResidualTable
) -> list[Statement]:
    """Add what each curve, as fitted, explains of the excess on held-out runs."""
    out, left = [], held.residual
    for s, c in zip(statements, curves, strict=False):
        says = predicted(c, fitted, held)
        if says is None:
            out.append(s)
            continue
        rest = left - says
        before, after = (float(np.einsum("kn,kl,ln->", x, held.precision, x)) for x in (left, rest))
        out.append(replace(s, held_out=float(np.clip((before - after) / held.excess, -1.0, 1.0))))
        left = rest
    return [*out, *statements[len(out) :]]
