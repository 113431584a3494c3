"""Localisation of a gap: which share of the excess goes with a coordinate, a sensor, a frequency, a run.

Coordinates are taken one after the other, the one that explains most of what is still there first, so that
shares add up to at most the whole and nothing is said twice. Each share is counted on runs that the curve was
not fitted on. Everything that is tried is tested with the same random signs of the runs (`sign_flips`), also
the effects of the catalogue, and each p-value is corrected for all of it by the largest statistic of all.
Frequencies and single runs are few numbers; they are corrected for their count (Bonferroni).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.change_points import change_points
from hallsym.diagnosis.coordinates import coordinates, unit_of
from hallsym.diagnosis.curve_words import described
from hallsym.diagnosis.curves import Curve, over, run_gains
from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.measurement_error import WHITE, with_noise
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.record import Statement
from hallsym.diagnosis.residual_table import ResidualTable, both, residual_table
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.selection import Screened
from hallsym.diagnosis.shares import clear, of_frequencies, of_links, of_powers, of_runs, outputs, sensors
from hallsym.diagnosis.sign_flips import Joint
from hallsym.diagnosis.words import percent, plain, shown


@dataclass(frozen=True, eq=False)
class Located:
    """Statements on where an excess lies, and what they rest on.

    `curves`: behind the statements on coordinates. `fitted`, `held`: the residual on fitted and on held-out
    runs, None where there are no samples.
    """

    statements: tuple[Statement, ...]
    curves: tuple[Curve, ...]
    fitted: ResidualTable | None
    held: ResidualTable | None = None


def located(
    base: Base,
    runs: Sequence[int],
    screened: Screened | None = None,
    faults: Sequence[Fault] = (),
    variance: float = 1.0,
    *,
    noisy: bool = False,
) -> Located:
    """Return the statements with what they rest on.

    `screened`: the catalogue at `base`, for the links of the chain. `faults`: of samples, their power as a
    part of `variance`, the whitened residual's. `noisy`: the residual is noise, which has a spectrum and lies
    at no frequency.
    """
    fitted, held = both(base, runs)
    steps = _steps([r for r in (fitted, held) if r is not None])
    if fitted is None or fitted.excess <= base.policy.negligible * fitted.residual.size:
        return Located(tuple(steps), (), fitted, held)
    tried = _Tried(base, fitted, screened)
    statements, curves, joint = _coordinates(tried)
    if held is not None and held.excess > 0:
        statements = _confirmed(statements, curves, held)
    if not statements and not clear(fitted):
        return Located(tuple(steps), tuple(curves), fitted, held)
    told = sum(s.share for s in statements)
    mains, octaves = of_frequencies(fitted, told)
    if mains and mains[0].share > told:
        statements, mains = [*mains, *statements], []
    size = variance * fitted.residual.size / fitted.excess
    bad = [replace(f, power=f.power * size) for f in faults]
    scores = screened.scores if screened else []
    counted = [replace(s, p_value=max(s.p_value, joint.p_value(s.statistic))) for s in scores]
    said = of_links(base, counted, fitted, bad) if counted else []
    for p, statistics in tried.powers:
        said += of_powers(p, [joint.p_value(z[0]) for z in statistics], base.policy)
    said += [*mains, *(() if noisy else octaves), *of_runs(fitted, told)]
    if steps and steps[0].share > told:
        statements = [*steps, *statements]
    else:
        said = [*steps, *said]
    worded = (
        s if s.p_value < base.policy.certain else replace(s, text=f"perhaps {s.text}")
        for s in (*statements, *said)
    )
    return Located(tuple(worded), tuple(curves), fitted, held)


def _steps(tables: Sequence[ResidualTable]) -> list[Statement]:
    """Return the steps within runs that are certain, and what they take of the excess of their side."""
    side = {run: r for r in tables for run in dict.fromkeys(r.run.tolist())}
    out = []
    for s in change_points(*tables):
        r = side[s.run]
        share = float(np.clip(s.squares / r.excess, 0.0, 1.0)) if r.excess > 0 else 0.0
        if s.p_value < r.policy.certain and share >= r.policy.negligible:
            size = shown(abs(s.size), unit_of(r.channels[s.channel]))
            text = f"{percent(share)} of the excess is a step of {plain(r.channels[s.channel])} by {size}"
            at = f"run {s.run} at {s.instant_s:.6g} s"
            out.append(Statement("run", at, share, s.p_value, f"{text} in {at}"))
    return sorted(out, key=lambda s: -s.share)


class _Tried:
    """Everything that is tried on a residual, and what its p-values are corrected for."""

    def __init__(self, base: Base, r: ResidualTable, screened: Screened | None) -> None:
        self.r = r
        noisy = with_noise(base, screened.colour if screened else WHITE)
        moved = None if noisy is None else residual_table(noisy, list(dict.fromkeys(r.run.tolist())))
        if moved is not None and moved.residual.shape != r.residual.shape:
            moved = None
        self.every = [each for c in coordinates(r) for each in over(r, c, moved)]
        self.powers = [(p, p.statistics(r.block)) for p in (outputs(r), sensors(r))]
        self.others = [z for _, each in self.powers for z in each]
        if screened and screened.top is not None:
            self.others.append(screened.top)

    def curves(self, left: np.ndarray, taken: Sequence[str]) -> tuple[list[Curve], Statement | None, Joint]:
        """Curves of what is left over all coordinates but some, a statement on gains of the runs' own.

        Both are corrected for each other and for all that is no coordinate, by the tests that are returned.
        """
        found = [t.curve(left) for t in self.every if t.coordinate.name not in taken]
        explained, own, _ = run_gains(self.r, left)
        joint = Joint([*(c.statistic for c in found), own, *self.others])
        return found, _own_gain(explained / self.r.excess, joint.p_value(own[0]), self.r.policy), joint


# -- coordinates -------------------------------------------------------------------------------------------


def _coordinates(tried: _Tried) -> tuple[list[Statement], list[Curve], Joint]:
    """Coordinates one after the other, each with what it explains beyond those before.

    Of those that explain nearly the same the most telling is named. A gain of its own in every run is named
    where no coordinate explains most of what it does. The tests that are returned are those of all
    coordinates, beside which the rest is tested.
    """
    r, excess, policy = tried.r, tried.r.excess, tried.r.policy
    statements, curves, left = list[Statement](), list[Curve](), r.residual
    found, run, first_joint = tried.curves(left, [])
    joint = first_joint
    while True:
        chance, least = joint.p_value, policy.negligible * excess
        good = [c for c in found if chance(c.statistic[0]) < policy.false_alarm and c.explained > least]
        best = max((c.explained for c in good), default=0.0)
        if run and policy.half * run.share * excess > best:
            statements.append(run)
            break
        if not good:
            break
        first = next(c for c in good if c.explained >= (1 - policy.minor) * best)
        share = min(first.explained / excess, 1.0 - sum(s.share for s in statements))
        if share < policy.negligible:
            break
        statements.append(described(r, first, share, chance(first.statistic[0]), bool(statements)))
        curves.append(first)
        left = left - first.predicted
        found, run, joint = tried.curves(left, [c.coordinate.name for c in curves])
    return statements, curves, first_joint


def _own_gain(share: float, p: float, policy: Policy) -> Statement | None:
    if p >= policy.false_alarm or share <= policy.negligible:
        return None
    share = min(share, 1.0)
    text = f"{percent(share)} of the excess is a gain that differs from run to run and follows nothing logged"
    return Statement("run", "gain of its own", share, p, text)


def _confirmed(statements: list[Statement], curves: list[Curve], held: ResidualTable) -> list[Statement]:
    """Add what each curve, as fitted, explains of the excess on held-out runs."""
    out, left = [], held.residual
    for s, c in zip(statements, curves, strict=False):
        says = c.says(held)
        if says is None:
            out.append(s)
            continue
        rest = left - says
        before, after = (float(np.einsum("kn,kl,ln->", x, held.precision, x)) for x in (left, rest))
        out.append(replace(s, held_out=float(np.clip((before - after) / held.excess, -1.0, 1.0))))
        left = rest
    return [*out, *statements[len(out) :]]
