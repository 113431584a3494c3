"""Steps within runs: a reading that jumps once, as a mount that slips makes it.

A step lies in one run, so random signs of the runs say nothing of it. It is held against the largest step
that each other run seems to have: noise of any memory makes such steps in every run, of much the same size.
"""

from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.p_values import beyond_one
from hallsym.diagnosis.regression import NIL
from hallsym.diagnosis.residual_table import ResidualTable, slices
from hallsym.estimation import pseudo_inverse
from hallsym.log.quality.scan import FEWEST_SAMPLES


@dataclass(frozen=True)
class ChangePoint:
    """The largest step within a run: channel, instant [s since the log began] and size [its unit].

    `p_value`: that noise makes as large a step in any of the runs. `squares`: whitened squares that it takes
    off the residual.
    """

    run: int
    channel: int
    instant_s: float
    size: float
    squares: float
    p_value: float = 1.0


def change_points(*tables: ResidualTable) -> tuple[ChangePoint, ...]:
    """Return the largest step of each run that is long enough, with p-values; none of too few runs.

    `tables`: the residual on fitted and on held-out runs, each of which may step.
    """
    found, levels = [], []
    for r in tables:
        for at in slices(r.run):
            if r.timed and at.stop - at.start >= 2 * FEWEST_SAMPLES:
                step, level = _largest(r, at)
                found.append(step)
                levels.append(level)
    if not found or len(found) < tables[0].policy.fewest:
        return ()
    each = np.array(levels)
    p = [min(1.0, len(each) * beyond_one(v, np.delete(each, k))) for k, v in enumerate(each)]
    return tuple(replace(s, p_value=value) for s, value in zip(found, p, strict=True))


def _largest(r: ResidualTable, at: slice) -> tuple[ChangePoint, float]:
    """Return the largest step of a run, and the logarithm of its squares over what it leaves of them.

    Offset and sensitivity step together, as those of a probe that moves do; the run has both of its own.
    """
    n = at.stop - at.start
    k = np.arange(FEWEST_SAMPLES, n - FEWEST_SAMPLES + 1)
    found = [_steps(r.residual[c, at], r.sensed[c, at], k) for c in range(len(r.channels))]
    share = np.array([explained / max(whole, 1e-300) for explained, _, whole in found])
    channel, place = np.unravel_index(int(np.argmax(share)), share.shape)
    explained, size, _ = found[channel]
    most = float(share[channel, place])
    instant = float(r.columns["campaign_s"][at][k[place]])
    weight = float(1 / np.linalg.inv(r.precision)[channel, channel])
    step = ChangePoint(
        int(r.run[at.start]), int(channel), instant, float(size[place]), weight * float(explained[place])
    )
    return step, float(np.log(max(most, 1e-300) / max(1 - most, 1e-12)))


def _steps(y: np.ndarray, x: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the squares that a step before each sample `k` takes off `y` (n,), its size, and all squares.

    `x`: (n,) expected reading, which a step of the sensitivity multiplies; sizes are those at its mean.
    """
    x = x - x.mean()
    own = np.vstack([np.ones_like(x), x / max(float(np.linalg.norm(x)), 1e-300)])
    own[0] /= np.sqrt(len(x))
    y = y - (own @ y) @ own

    def later(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.cumsum(values[..., ::-1], axis=-1)[..., ::-1][..., k])

    gram = np.array([[later(np.ones_like(x)), later(x)], [later(x), later(x * x)]])
    across = np.array([later(own), later(own * x)])  # (step, own, k)
    left = gram - np.einsum("ipt,jpt->ijt", across, across)
    explained, coefficients = solved(left, gram, np.array([later(y), later(x * y)]))
    return explained, coefficients[0], float(y @ y)


def solved(left: np.ndarray, raw: np.ndarray, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the squares (k,) that steps of offset and sensitivity take off, and their coefficients (2, k).

    `left`, `raw`: (2, 2, k) products of the columns, less what is a run's own and in full; `shared`: (2, k)
    what they have in common with the residual.
    """
    seen = np.einsum("iit->it", left) > NIL * np.einsum("iit->it", raw)  # else rounding
    inverse = pseudo_inverse((left * seen[:, None] * seen).transpose(2, 0, 1), NIL)
    coefficients = np.einsum("tij,jt->it", inverse, shared * seen)
    return np.einsum("it,it->t", shared * seen, coefficients), coefficients
