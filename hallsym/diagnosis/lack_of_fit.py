"""Lack of fit: does what a model leaves depend on anything? The curves of a localisation are held against it.

What a curve over a coordinate (`curves`), or a gain of every run, predicts on runs (or stretches) that it was
not fitted on is lack of fit, whatever the noise floor is said to be; its p-value rests on signs, so it is
honest for noise that is correlated in time. Memory is constant.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from hallsym.diagnosis.coordinates import coordinates
from hallsym.diagnosis.curves import over, run_gains
from hallsym.diagnosis.p_values import statistic_at
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.residual_table import residual_table
from hallsym.diagnosis.residuals import Base, found_once, pieces
from hallsym.diagnosis.survey import SEGMENT


@dataclass(frozen=True)
class Shape:
    """How far a family of curves lowers the gap metric of runs it was not fitted on, and its p-value.

    `name`: of the coordinate that the residual may depend on.
    """

    name: str
    drop: float
    p_value: float


@dataclass(frozen=True, eq=False)
class LackOfFit:
    """Families of curves, best first; `tones`: decrease of the gap metric without its steady tones."""

    shapes: tuple[Shape, ...]
    tones: float = 0.0

    def best(self, level: float) -> Shape | None:
        """Return the family that explains most and is no chance (level corrected for all tried)."""
        tried = max(len(self.shapes), 1)
        return next((s for s in self.shapes if s.p_value * tried < level and s.drop > 0), None)


@found_once
def lack_of_fit(base: Base, runs: frozenset[int]) -> LackOfFit:
    """Hold the families of curves against what `base` leaves on `runs`."""
    r = residual_table(base, runs)
    if r is None:
        return LackOfFit(())
    whole = max(r.metric(r.residual), 1e-300)
    _, z, foreseen = run_gains(r, r.residual)
    found = [("gain of its own", foreseen, float((z >= z[0]).mean()))]
    for c in coordinates(r):
        curves = [each.curve(r.residual) for each in over(r, c)]
        found += [(c.name, x.foreseen, x.p_value) for x in curves]
    shapes = [Shape(name, 1 - r.metric(r.residual - x) / whole, p) for name, x, p in found]
    return LackOfFit(tuple(sorted(shapes, key=lambda s: -s.drop)), tones(base, runs))


# -- steady tones --------------------------------------------------------------------------------------------


LOBE = 4
"""Frequencies that a line takes in a spectrum with Hann's window, the width of its main lobe: so many at the
slow end are drift, and a median over four lobes is what lies between lines."""


def tones(base: Base, runs: Iterable[int]) -> float:
    """Return by how much the gap metric of `runs` falls without the steady tones of the decoded error."""
    model, back = base.model, np.linalg.inv(base.whiten)
    length, run, power = 2 * SEGMENT, [], []
    window = np.hanning(length)
    for piece in pieces(base, frozenset(runs)):
        pose, state = ([piece.data[c] for c in names] for names in (model.references, model.state))
        e = np.einsum("iks,ks->is", base.to_pose(pose, state), back @ piece.residual)
        e *= base.pose_weights[:, None]
        e = np.where(piece.used, e, 0.0)
        for low in range(0, e.shape[1] - length + 1, length):
            part = e[:, low : low + length]
            part = (part - part.mean(axis=1, keepdims=True)) * window
            run.append(piece.run)
            power.append((np.abs(np.fft.rfft(part, axis=1)) ** 2).sum(axis=0))
    if len(run) < base.policy.fewest:
        return 0.0
    P = np.sum(power, axis=0)
    smooth = median_filter(P, 4 * LOBE - 1, mode="reflect")
    freedom = 2 * len(model.pose) * len(run)
    certain = P * freedom > smooth * statistic_at(base.policy.certain / len(P), freedom)
    certain[:LOBE] = False
    if not _steady(np.array(run), np.array(power), certain, base.policy):
        return 0.0
    share = float(np.where(certain, P - smooth, 0.0).sum() / max(P.sum(), 1e-300))
    return 1 - float(np.sqrt(max(1 - share, 0.0)))


def _steady(run: np.ndarray, power: np.ndarray, certain: np.ndarray, policy: Policy) -> bool:
    """Return whether lines have the same power (segments, frequencies) all through a run, unlike noise.

    Of few segments some noise is steady by chance, so no more of the other frequencies may be as steady than
    a false alarm has; of many, all noise is nearly as steady, so the line must be by a good part more. Runs
    of one segment are held against each other.
    """
    _, index, count = np.unique(run, return_inverse=True, return_counts=True)
    _, group, count = np.unique(
        np.where(count[index] > 1, index, -1), return_inverse=True, return_counts=True
    )
    means = np.array([power[group == k].mean(axis=0) for k in range(len(count))]).clip(1e-300)
    varies = ((power - means[group]) ** 2 / means[group]).sum(axis=0)
    squares = (count - 1) @ means
    beside = np.convolve(certain, np.ones(3), mode="same") > 0  # a part of the line's power is theirs
    others = varies[~beside] / np.maximum(squares[~beside], 1e-300)
    if not len(others) or not squares[certain].sum() > 0:
        return True
    line = varies[certain].sum() / squares[certain].sum()
    return bool(
        np.mean(others <= line) < policy.false_alarm and line < (1 - policy.minor) * np.median(others)
    )
