"""How large the gap is, and which outputs, sensors, frequencies, runs and links have much of it.

An output or a sensor is named when it has more than its part: noise that is larger than it was stated is
larger everywhere, and is no place where a gap lies.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.diagnosis.decoded_errors import DecodedErrors
from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.p_values import beyond, beyond_one, statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.record import Size, Sizes, Statement
from hallsym.diagnosis.residual_table import FrequencyBand, ResidualTable
from hallsym.diagnosis.residuals import Base
from hallsym.diagnosis.scores import Score, by_name
from hallsym.diagnosis.sign_flips import of_means
from hallsym.diagnosis.words import percent, plain
from hallsym.model import LINKS


@dataclass(frozen=True, eq=False)
class Powers:
    """Squares of outputs or sensors on some samples: `squares` (k, n) and what noise makes of them (k,)."""

    kind: str
    names: tuple[str, ...]
    squares: np.ndarray
    noise: np.ndarray
    weight: np.ndarray
    """(k,) what each counts by: outputs as in the gap metric, sensors by their own noise."""

    @property
    def rms(self) -> np.ndarray:
        """Root mean squares, (k,), in the unit of each."""
        return np.sqrt(self.squares.mean(axis=1))

    @property
    def shares(self) -> np.ndarray:
        """Share of the excess of all together, (k,); nan where there is none."""
        above = (self.squares.sum(axis=1) - self.noise * self.squares.shape[1]) * self.weight
        return above / above.sum() if above.sum() > 0 else np.full(len(above), np.nan)

    def statistics(self, block: np.ndarray) -> list[np.ndarray]:
        """Statistics with random signs of the blocks that each has more than its part, (draws,) each."""
        over = self.squares / self.noise[:, None]
        if len(over) < 2:
            return []
        return [of_means(means(row, block)) for row in over - over.mean(axis=0)]

    @property
    def parts(self) -> np.ndarray:
        """Share of the noise of all together, (k,)."""
        own = self.noise * self.weight
        return own / own.sum()


def outputs(r: ResidualTable) -> Powers:
    """Return the squares of the residual as it moves the decoded pose."""
    noise = np.square(np.einsum("ikn,kl->iln", r.decoding, np.linalg.cholesky(np.linalg.inv(r.precision))))
    return Powers("output", r.pose, r.decoded(r.residual) ** 2, noise.sum(axis=1).mean(axis=1), r.weights**2)


def sensors(r: ResidualTable) -> Powers:
    """Return the squares of the residual of the readings."""
    noise = np.diag(np.linalg.inv(r.precision)).copy()
    return Powers("sensor", r.channels, r.residual**2, noise, 1 / noise)


def of_powers(p: Powers, p_values: Sequence[float], policy: Policy) -> list[Statement]:
    """Which of several outputs or sensors have more than their part of the excess."""
    said = []
    for k, (name, chance) in enumerate(zip(p.names, p_values, strict=False)):
        share = float(np.clip(p.shares[k], 0.0, 1.0))
        if chance < policy.false_alarm and share >= p.parts[k] + policy.minor:
            seen = "is seen by" if p.kind == "sensor" else "lies in"
            text = f"{percent(share)} of the excess {seen} {plain(name)}, one of {len(p.names)} {p.kind}s"
            said.append(Statement(p.kind, name, share, chance, text))
    return sorted(said, key=lambda s: -s.share)


def clear(r: ResidualTable) -> bool:
    """Whether the excess is more than chance: block by block, so that memory of the noise does not count."""
    return beyond(means(r.squares - len(r.residual), r.part)) < r.policy.certain


def means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the mean of `values` (n,) in each group."""
    _, index = np.unique(group, return_inverse=True)
    return np.bincount(index, values) / np.bincount(index)


def of_runs(r: ResidualTable, told: float) -> list[Statement]:
    """Whether one run has much more than its part of the excess.

    A square counts up to the largest that noise makes in so many samples, so no few wild samples are a run.
    """
    order, index = np.unique(r.run, return_inverse=True)
    squares = np.minimum(r.squares, statistic_at(1 / len(r.run), len(r.residual))) - len(r.residual)
    sums, counts = np.bincount(index, squares), np.bincount(index)
    level = np.log(sums / counts + len(r.residual))
    k, U = int(np.argmax(level)), len(order)
    if r.policy.fewest > U or sums[k] <= 0 or told > r.policy.half:
        return []
    p = min(1.0, U * beyond_one(float(level[k]), np.delete(level, k)))
    share = float(np.clip(sums[k] / max(squares.sum(), 1e-300), 0.0, 1.0))
    if p >= r.policy.certain or share < 1 / U + r.policy.minor:
        return []
    text = f"{percent(share)} of the excess lies in run {order[k]}, one of {U} fitted runs"
    return [Statement("run", f"run {order[k]}", share, p, text)]


def of_frequencies(r: ResidualTable, told: float) -> tuple[list[Statement], list[Statement]]:
    """Return statements on the mains and on octaves.

    Those are named that hold more than the part of them that white noise would have; octaves that follow each
    other are one.
    """
    s = r.spectrum
    runs = sorted({run for kind in s.white.values() for run in kind})
    if not runs or not r.timed:
        return [], []
    white = {k: np.array([v.get(run, 0.0) for run in runs]) for k, v in s.white.items()}
    power = {k: np.array([v.get(run, 0.0) for run in runs]) for k, v in s.power.items()}
    everything = np.sum(list(white.values()), axis=0)
    excess = float(sum(v.sum() for v in power.values()) - everything.sum())
    if excess <= 0:
        return [], []
    worth = []
    for band, own in white.items():
        over, part = power[band] - own, float(own.sum() / everything.sum())
        share = float(over.sum()) / excess
        p = min(1.0, len(white) * beyond(over / everything))
        named = band.mains or told <= r.policy.half
        if p < r.policy.certain and named and share >= part + r.policy.minor:
            worth.append((share, band, p))
    mains, octaves, rest = list[Statement](), list[Statement](), 1.0
    for share, band, p in sorted(_joined(worth), key=lambda w: -w[0]):
        share = min(share, rest)  # bands below the noise make the others more than the whole
        rest -= share
        if share >= r.policy.negligible:
            text = f"{percent(share)} of the excess lies at {band.name}"
            (mains if band.mains else octaves).append(Statement("frequency", band.name, share, p, text))
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
        told = clear(r)
        rms = errors[side].rms
        noise = np.array([floors[side].get(c, 0.0) for c in r.pose])
        seen = sensors(r)
        of = [(out.outputs, outputs(r), rms, noise), (out.sensors, seen, seen.rms, np.sqrt(seen.noise))]
        for store, powers, size, least in of:
            for name, row in _sizes(powers, r.part, size, least, told).items():
                store.setdefault(name, {})[side] = row
    return out


def _sizes(p: Powers, block: np.ndarray, rms: np.ndarray, noise: np.ndarray, told: bool) -> dict[str, Size]:
    above = np.maximum(rms**2 - noise**2, 0.0)
    weighed = above * p.weight
    total = float(weighed.sum())
    return {
        name: Size(
            rms=float(rms[k]),
            noise=float(noise[k]),
            above=float(np.sqrt(above[k])),
            share=float(weighed[k] / total) if told and total > 0 else None,
            p_value=beyond(means(p.squares[k] / p.noise[k] - 1.0, block)),
        )
        for k, name in enumerate(p.names)
    }


# -- links of the chain --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Link:
    """The effect or fault `name` of a link, and the share of the excess that it takes up."""

    name: str
    share: float
    p_value: float


def of_links(
    base: Base, scored: Sequence[Score], r: ResidualTable, faults: Sequence[Fault]
) -> list[Statement]:
    """Return statements on the links that can surely take up much of the excess of `r`.

    `scored`: effects at `base`, each by its own score: the gap metric, cross-validated, and the p-value for
    all that was tried. `faults`: of single samples, with `power` as part of the excess.
    """
    out = outputs(r)
    whole, noise = float(out.weight @ out.squares.mean(axis=1)), float(out.weight @ out.noise)
    excess = max(whole - noise, 1e-300)
    found: dict[str, Link] = {}

    def add(link: str, name: str, share: float, p_value: float) -> None:
        if link not in found or share > found[link].share:
            found[link] = Link(name, float(np.clip(share, 0.0, 1.0)), p_value)

    for s in by_name(scored):
        if not s.absorbed:
            add(_link_of(base, s), s.effect.name, (1 - s.ratio**2) * whole / excess, s.p_value)
    for f in faults:
        add(f.record.link, f.name, f.power, f.p_value)
    likely = [f for f in found.values() if f.p_value < r.policy.false_alarm]
    least = max(r.policy.negligible, (1 - r.policy.minor) * max((f.share for f in likely), default=0.0))
    said = []
    for link in sorted(found, key=(*LINKS, *found).index):
        own = found[link]
        other = max((k for k in found if k != link), key=lambda k: found[k].share, default=None)
        beside = f"{other} {percent(found[other].share)}" if other else "none tested"
        text = f"{own.name}; another link: {beside}"
        if own in likely and own.share >= least:
            text = f"{percent(own.share)} of the excess can come from the {link} ({text})"
            said.append(Statement("link", link, own.share, own.p_value, text))
    # of links that take up the same the first of the chain stands first, whatever the rounding
    return sorted(said, key=lambda s: -round(s.share, 6))


def _link_of(base: Base, score: Score) -> str:
    """Return the link that an effect acts on; one that does not say it is placed by the step that it adds."""
    if score.effect.link in LINKS:
        return score.effect.link
    old = {id(step) for _, step in base.model.steps}
    return next((on for on, step in score.model.steps if id(step) not in old), score.effect.link)
