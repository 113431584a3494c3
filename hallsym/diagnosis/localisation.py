"""Where a gap lies: which share of the excess goes with a coordinate, a sensor, a frequency, a run, a link.

Coordinates are taken one after the other, the one that explains most of the remaining residual first, so that
shares add up to at most 1. Each share is measured on runs that the curve was not fitted to. All coordinates
and all effects of the catalogue are tested with the same sign flips of the runs (`p_values`), and each
p-value is corrected for all of them by the maximum statistic. Frequencies and single runs are few; they are
corrected for their number (Bonferroni). An output or a sensor is named if it has more than its part of the
excess: noise larger than stated is larger everywhere and is not localised.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.curves import MEMORIES, Curve, coordinates, over, run_gains, unit_of
from hallsym.diagnosis.decoded_errors import DecodedErrors
from hallsym.diagnosis.facts import change_points
from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.p_values import Joint, beyond, beyond_one, of_means, statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.record import Band, CurveShape, Size, Sizes, Statement
from hallsym.diagnosis.residual_table import (
    FrequencyBand,
    ResidualTable,
    both,
    means,
    phase,
    spectrum,
    sums,
)
from hallsym.diagnosis.residuals import Base, pieces
from hallsym.diagnosis.scores import Score, Screen, by_name
from hallsym.diagnosis.words import plain, shown
from hallsym.estimation.calibration import coverage_factor
from hallsym.log.core import edges_of
from hallsym.model import LINKS
from hallsym.output import percent
from hallsym.units import readable


@dataclass(frozen=True, eq=False)
class Located:
    """Statements on where an excess lies, and the `curves` behind those on coordinates."""

    statements: tuple[Statement, ...]
    curves: tuple[Curve, ...]


def located(
    base: Base,
    runs: Sequence[int],
    screened: Screen | None = None,
    faults: Sequence[Fault] = (),
    variance: float = 1.0,
    *,
    noisy: bool = False,
) -> Located:
    """Return the statements with their curves.

    `screened`: the catalogue at `base`, for the links of the chain. `faults`: of samples, with their power as
    a part of `variance`, that of the whitened residual. `noisy`: the residual is noise, which is localised at
    no frequency.
    """
    fitted, holdout = both(base, runs)
    tables = {"fitted": fitted, "holdout": holdout}
    steps = _steps([r for r in tables.values() if r is not None])
    single = [s for which, r in tables.items() if r is not None for s in of_runs(r, which)]
    if fitted is None or fitted.excess <= base.policy.negligible * fitted.residual.size:
        return Located((*steps, *single), ())
    powers = [(p, p.statistics(fitted.block)) for p in (outputs(fitted), sensors(fitted))]
    others = [z for _, each in powers for z in each]
    if screened and screened.top is not None:
        others.append(screened.top)
    statements, curves, joint = _coordinates(fitted, holdout, others)
    if not statements and not clear(fitted):
        return Located((*steps, *single), tuple(curves))
    explained = sum(s.share for s in statements)
    mains, octaves = of_frequencies(fitted, frozenset(runs) - base.holdout, explained)
    if mains and mains[0].share > explained:
        statements, mains = [*mains, *statements], []
    said = list[Statement]()
    if screened and screened.scores:
        size = variance * fitted.residual.size / fitted.excess
        bad = [replace(f, power=f.power * size) for f in faults]
        counted = [replace(s, p_value=max(s.p_value, joint.p_value(s.statistic))) for s in screened.scores]
        said = of_links(base, counted, powers[0][0], bad)
    for p, statistics in powers:
        said += of_powers(p, [joint.p_value(z[0]) for z in statistics], base.policy)
    said += [*mains, *(() if noisy else octaves), *(() if explained > base.policy.half else single)]
    if steps and steps[0].share > explained:
        statements = [*steps, *statements]
    else:
        said = [*steps, *said]
    worded = (
        s if s.p_value < base.policy.certain else replace(s, text=f"perhaps {s.text}")
        for s in (*statements, *said)
    )
    return Located(tuple(worded), tuple(curves))


def _statement(by: str, at: str, share: float, p: float, text: str) -> Statement:
    """Return a statement on a `share` of the excess, in words."""
    return Statement(by, at, share, p, f"{percent(share)} of the excess {text}")


def clear(r: ResidualTable) -> bool:
    """Whether the excess is significant: block by block, so that autocorrelation does not count."""
    return beyond(means(r.squares - len(r.residual), r.part)) < r.base.policy.certain


# -- coordinates -------------------------------------------------------------------------------------------


def _coordinates(
    r: ResidualTable,
    holdout: ResidualTable | None,
    others: Sequence[np.ndarray],
) -> tuple[list[Statement], list[Curve], Joint]:
    """Return coordinates in order, each with the part it explains beyond those before.

    Of several that explain nearly the same the first in `coordinates` is named. A gain for each run is named
    where no coordinate explains most of its part. `holdout`: the residual on holdout runs, on which each
    fitted curve is evaluated too. `others`: further statistics for which p-values are corrected. The returned
    tests are those of all coordinates.
    """
    excess, policy = r.excess, r.base.policy
    every = [each for c in coordinates(r) for each in over(r, c)]
    statements, curves, joints, left = list[Statement](), list[Curve](), list[Joint](), r.residual
    left_there = np.zeros(0) if holdout is None else holdout.residual
    while True:
        taken = [c.coordinate.name for c in curves]
        found = [t.curve(left) for t in every if t.coordinate.name not in taken]
        of_runs_own, own, _ = run_gains(r, left)
        joints.append(Joint([*(c.statistic for c in found), own, *others]))
        chance = joints[-1].p_value
        good = [
            c
            for c in found
            if chance(c.statistic[0]) < policy.false_alarm and c.explained > policy.negligible * excess
        ]
        best, share = max((c.explained for c in good), default=0.0), min(of_runs_own / excess, 1.0)
        certain = chance(own[0]) < policy.false_alarm and share > policy.negligible
        if certain and policy.half * share * excess > best:
            text = "is a gain that differs from run to run and follows nothing logged"
            statements.append(_statement("run", "gain of its own", share, chance(own[0]), text))
            break
        if not good:
            break
        first = next(c for c in good if c.explained >= (1 - policy.minor) * best)
        share = min(first.explained / excess, 1.0 - sum(s.share for s in statements))
        if share < policy.negligible:
            break
        statement = described(first, share, chance(first.statistic[0]))
        if statements:
            statement = replace(statement, text=f"a further {statement.text}")
        if holdout is not None and holdout.excess > 0 and (says := first.says(holdout)) is not None:
            before, left_there = holdout.whitened_squares(left_there).sum(), left_there - says
            part = (before - holdout.whitened_squares(left_there).sum()) / holdout.excess
            statement = replace(statement, held_out=float(np.clip(part, -1.0, 1.0)))
        statements.append(statement)
        curves.append(first)
        left = left - first.predicted
    return statements, curves, joints[0]


def described(c: Curve, share: float, p: float) -> Statement:
    """Return the statement that `share` of the excess follows a curve."""
    r = c.over.r
    text = f"goes with {c.coordinate.name}{_part(c, r.base.policy)}"
    seen = (c.predicted**2).sum(axis=1) * np.diag(r.precision)
    k = int(np.argmax(seen))
    if seen[k] > r.base.policy.half * seen.sum():
        text += f"; seen by {plain(r.base.model.channels[k])} above all"
    return _statement(c.coordinate.name, "", share, p, text)


def _part(c: Curve, policy: Policy) -> str:
    """Which follows the coordinate most, gain or offset, and which part of several."""
    names = [readable(n)[2].capitalize() for n in c.coordinate.of] if c.coordinate.gain else []
    if names:
        offset, gain = (c.offset**2).sum(axis=0).reshape(2, len(names))
        parts = (offset + gain) / (offset + gain).sum()
        each = ", ".join(f"{a} {percent(x)}" for a, x in zip(names, parts, strict=True))
    elif c.gain is not None:
        offset, gain = (np.array(_size(curve)) for curve in (c.offset, c.gain))
        each = ""
    else:
        return ""
    least = policy.half * (gain.sum() + offset.sum())
    what = "the gain" if gain.sum() > least else "the offset" if offset.sum() > least else ""
    said = ": ".join(filter(None, (what, each)))
    return f" ({said})" if said else ""


NAMES = {"sensed": "reading_m", "rate": "reading_rate_m_s"}
"""Names in JSON of columns that every sensor has for itself."""


def shape(c: Curve) -> CurveShape:
    """Return a curve as data; the bands at 95 % come from runs left out in turn."""
    model = c.over.r.base.model
    channels, references = model.channels, model.references
    m = len(c.over.at)
    gain = c.gain is not None and _size(c.gain) > _size(c.offset)
    part, scale = (slice(m, None), c.over.scale) if gain else (slice(m), 1.0)
    column = {**NAMES, **{phase(x): x for x in references}}.get(c.coordinate.column, c.coordinate.column)
    value, wide = c.beta[:, part], coverage_factor(np.inf) * c.spread[:, part]
    bands = (np.stack([value, value - wide, value + wide], axis=1) / scale).tolist()
    labels, names = None, [readable(n)[2] for n in c.coordinate.of]
    if c.coordinate.memory:
        labels = tuple(f"play {w:g} rms" for w in MEMORIES)
    elif c.coordinate.gain and names:
        labels = tuple(f"{what}, {n.capitalize()}" for what in ("offset", "gain") for n in names)
    elif names:
        labels = tuple(readable(n)[2].removesuffix("_ref") for n in references)
    return CurveShape(
        coordinate=c.coordinate.name,
        line=c.coordinate.ordered,
        column=column,
        unit=c.coordinate.unit,
        kind="gain" if gain else "offset",
        value_unit="1" if gain else unit_of(channels[0]),
        grid=tuple(c.over.at.tolist()),
        labels=labels,
        readings={channel: Band(*map(tuple, each)) for channel, each in zip(channels, bands, strict=True)},
    )


def _size(curve: np.ndarray) -> float:
    """Mean square of a curve about its mean: a constant is the model's own."""
    return float(((curve - curve.mean(axis=1, keepdims=True)) ** 2).mean())


# -- steps, runs and frequencies ---------------------------------------------------------------------------


def _steps(tables: Sequence[ResidualTable]) -> list[Statement]:
    """Return the significant steps within runs, and their parts of the excess of their side."""
    side = {run: r for r in tables for run in set(r.run.tolist())}
    out = []
    for s in change_points(*tables):
        r = side[s.run]
        policy, channel = r.base.policy, r.base.model.channels[s.channel]
        share = float(np.clip(s.squares / r.excess, 0.0, 1.0)) if r.excess > 0 else 0.0
        if s.p_value < policy.certain and share >= policy.negligible:
            size, at = shown(abs(s.size), unit_of(channel)), f"run {s.run} at {s.instant_s:.6g} s"
            text = f"is a step of {plain(channel)} by {size} in {at}"
            out.append(_statement("run", at, share, s.p_value, text))
    return sorted(out, key=lambda s: -s.share)


def of_runs(r: ResidualTable, which: str) -> list[Statement]:
    """Whether one run has much more than its part of the excess of the fitted or the holdout runs, `which`.

    A square counts up to the largest that noise makes in so many samples, so that a few outliers do not
    count.
    """
    policy = r.base.policy
    squares = np.minimum(r.squares, statistic_at(1 / len(r.run), len(r.residual))) - len(r.residual)
    level, each = np.log(means(squares, r.run) + len(r.residual)), sums(squares, r.run)
    k, U = int(np.argmax(level)), len(level)
    if policy.fewest > U or each[k] <= 0:
        return []
    p = min(1.0, U * beyond_one(float(level[k]), np.delete(level, k)))
    share = float(np.clip(each[k] / max(squares.sum(), 1e-300), 0.0, 1.0))
    if p >= policy.certain or share < 1 / U + policy.minor:
        return []
    name = f"run {r.run[edges_of(r.run)[k]]}"
    return [_statement("run", name, share, p, f"lies in {name}, one of {U} {which} runs")]


def of_frequencies(
    r: ResidualTable, runs: frozenset[int], explained: float
) -> tuple[list[Statement], list[Statement]]:
    """Return statements on the mains and on octaves of the residual on `runs`.

    Those are named that hold more than the part of them that white noise would have; octaves that follow each
    other are one.
    """
    policy, found = r.base.policy, spectrum(pieces(r.base, runs)) if r.base.timed else {}
    known = sorted({run for each in found.values() for run in each})
    powers = {band: np.array([each.get(run, np.zeros(2)) for run in known]).T for band, each in found.items()}
    everything = sum(white for _, white in powers.values())
    excess = float(sum((power - white).sum() for power, white in powers.values()))
    if excess <= 0:
        return [], []
    worth = []
    for band, (power, white) in powers.items():
        part, share = float(white.sum() / np.sum(everything)), float((power - white).sum()) / excess
        p = min(1.0, len(powers) * beyond((power - white) / everything))
        named = band.mains or explained <= policy.half
        if p < policy.certain and named and share >= part + policy.minor:
            worth.append((share, band, p))
    mains, octaves, rest = list[Statement](), list[Statement](), 1.0
    for share, band, p in sorted(_joined(worth), key=lambda w: -w[0]):
        share = min(share, rest)  # bands below the noise make the others more than the whole
        rest -= share
        if share >= policy.negligible:
            said = _statement("frequency", band.name, share, p, f"lies at {band.name}")
            (mains if band.mains else octaves).append(said)
    return mains, octaves


Worth = tuple[float, FrequencyBand, float]
"""A band with its share of the excess and its p-value."""


def _joined(worth: Sequence[Worth]) -> list[Worth]:
    """Return the bands by frequency, octaves that follow each other as one."""
    out: list[Worth] = []
    for share, band, p in sorted(worth, key=lambda w: (w[1].mains, w[1].low)):
        if out and not band.mains and out[-1][1].high == band.low:
            more, before, other = out.pop()
            share, band, p = share + more, FrequencyBand(before.low, band.high), max(p, other)
        out.append((share, band, p))
    return out


# -- outputs and sensors -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Powers:
    """Squares of outputs or sensors on some samples: `squares` (k, n) and their means by noise (k,).

    `weight`: (k,) of each: outputs as in the gap metric, sensors by their own noise.
    """

    kind: str
    names: tuple[str, ...]
    squares: np.ndarray
    noise: np.ndarray
    weight: np.ndarray

    def statistics(self, block: np.ndarray) -> list[np.ndarray]:
        """Statistics with random signs of the blocks that each has more than its part, (draws,) each."""
        over = self.squares / self.noise[:, None]
        if len(over) < 2:
            return []
        return [of_means(row) for row in means(over - over.mean(axis=0), block)]


def outputs(r: ResidualTable) -> Powers:
    """Return the squares of the residual as it moves the decoded pose."""
    noise = np.square(np.einsum("ikn,kl->iln", r.decoding, np.linalg.cholesky(r.base.covariance)))
    squares, weight = r.decoded(r.residual) ** 2, r.base.pose_weights**2
    return Powers("output", r.base.model.pose, squares, noise.sum(axis=1).mean(axis=1), weight)


def sensors(r: ResidualTable) -> Powers:
    """Return the squares of the residual of the readings."""
    return Powers("sensor", r.base.model.channels, r.residual**2, r.variance, 1 / r.variance)


def of_powers(p: Powers, p_values: Sequence[float], policy: Policy) -> list[Statement]:
    """Which of several outputs or sensors have more than their part of the excess."""
    own = p.noise * p.weight
    above = p.squares.mean(axis=1) * p.weight - own
    said = []
    for k, (name, chance) in enumerate(zip(p.names, p_values, strict=False)):
        share = float(np.clip(above[k] / above.sum(), 0.0, 1.0)) if above.sum() > 0 else np.nan
        if chance < policy.false_alarm and share >= own[k] / own.sum() + policy.minor:
            seen = "is seen by" if p.kind == "sensor" else "lies in"
            text = f"{seen} {plain(name)}, one of {len(p.names)} {p.kind}s"
            said.append(_statement(p.kind, name, share, chance, text))
    return sorted(said, key=lambda s: -s.share)


def sizes(
    residues: Mapping[str, ResidualTable | None],
    errors: Mapping[str, DecodedErrors],
    floors: Mapping[str, Mapping[str, float]],
) -> Sizes:
    """Return how large the gap is on each side, "fitted" and "held_out".

    Outputs come from `errors`, the decoded pose; sensors from `residues`. `floors`: noise by output. P-values
    come from blocks of samples.
    """
    out = Sizes()
    for side, r in residues.items():
        if r is None:
            continue
        explained, of_outputs, of_sensors = clear(r), outputs(r), sensors(r)
        noise = np.array([floors[side].get(c, 0.0) for c in of_outputs.names])
        rms = np.sqrt(of_sensors.squares.mean(axis=1))
        for store, p, size, least in (
            (out.outputs, of_outputs, errors[side].rms, noise),
            (out.sensors, of_sensors, rms, np.sqrt(of_sensors.noise)),
        ):
            above = np.maximum(size**2 - least**2, 0.0)
            total = float((above * p.weight).sum())
            over = means(p.squares / p.noise[:, None] - 1.0, r.part)
            for k, name in enumerate(p.names):
                store.setdefault(name, {})[side] = Size(
                    rms=float(size[k]),
                    noise=float(least[k]),
                    above=float(np.sqrt(above[k])),
                    share=float(above[k] * p.weight[k] / total) if explained and total > 0 else None,
                    p_value=beyond(over[k]),
                )
    return out


# -- links of the chain --------------------------------------------------------------------------------------


def of_links(base: Base, scored: Sequence[Score], out: Powers, faults: Sequence[Fault]) -> list[Statement]:
    """Return statements on the links whose effects significantly explain much of the excess.

    `scored`: effects at `base`, each by its own score: the gap metric, cross-validated, and the p-value for
    all that was tried. `out`: of the outputs. `faults`: of samples, with `power` as part of the excess.
    """
    whole, noise = float(out.weight @ out.squares.mean(axis=1)), float(out.weight @ out.noise)
    excess = max(whole - noise, 1e-300)
    claims = [
        Statement("link", _link_of(base, s), (1 - s.ratio**2) * whole / excess, s.p_value, s.effect.name)
        for s in by_name(scored)
        if not s.absorbed
    ]
    claims += [Statement("link", f.record.link, f.power, f.p_value, f.name) for f in faults]
    found: dict[str, Statement] = {}
    for claim in claims:
        if claim.at not in found or claim.share > found[claim.at].share:
            found[claim.at] = replace(claim, share=float(np.clip(claim.share, 0.0, 1.0)))
    policy = base.policy
    likely = [f for f in found.values() if f.p_value < policy.false_alarm]
    least = max(policy.negligible, (1 - policy.minor) * max((f.share for f in likely), default=0.0))
    said = []
    for own in sorted(likely, key=lambda f: (*LINKS, *found).index(f.at)):
        other = max((f for f in found.values() if f is not own), key=lambda f: f.share, default=None)
        beside = f"{other.at} {percent(other.share)}" if other else "none tested"
        if own.share >= least:
            text = f"can come from the {own.at} ({own.text}; another link: {beside})"
            said.append(_statement("link", own.at, own.share, own.p_value, text))
    # of links that take up the same the first of the chain stands first, whatever the rounding
    return sorted(said, key=lambda s: -round(s.share, 6))


def _link_of(base: Base, score: Score) -> str:
    """Return the link that an effect acts on; if not stated, that of the step that it adds."""
    if score.effect.link in LINKS:
        return score.effect.link
    old = {id(step) for _, step in base.model.steps}
    return next((on for on, step in score.model.steps if id(step) not in old), score.effect.link)
