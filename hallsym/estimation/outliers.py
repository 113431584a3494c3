"""Gross outliers: samples that neither the motion nor the noise explains."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy

from hallsym.log import Block
from hallsym.log.batches import Weigh
from hallsym.model.arrays import median, medians

WINDOW = 7
SPIKE = 10.0
"""Robust standard deviations from its neighbours above which a sample is a gross outlier, unless many spikes
lower the limit: at 7 the turning points of a raster would count."""
ABOUND, ODDS = 0.02, 100.0
"""Share of spikes in a block above which smaller jumps are tested too, and the odds required of such a jump.
Where spikes are few, smaller ones do no harm."""
MADE_FOR, CLEARLY = 0.1, 5.0
"""Largest share of spikes in a column, and standard deviations of their count above it beyond which they are
no spikes: steps, corners and rounding of a smooth column look like many."""
EXTRAPOLATED = 0.5
"""Weight of the deviations of the two samples at either end: extrapolated lines miss a curve by more than
lines through it."""
ROUNDS = 20
AROUND = 41
"""Samples around one whose jumps give the usual scale there: motion after rest, and ringing of that length,
are no spikes."""
MOSTLY_SPIKY, SPIKY_STD = 30, 0.38532
"""Percentile of jumps that gives their usual scale, and its value for unit normal noise: two thirds of them
may be spikes or neighbours of one, as where a tenth of all samples are spikes."""


@dataclass(eq=False)
class Filter:
    """Weights of a block's samples: 0 where any column has a spike, else 1.

    `find(block)`: the spikes (columns, samples), and the share of samples that are known to be bad by other
    columns. `wrong_for`: columns with too many (`MADE_FOR`) to be spikes, which do not count.
    """

    find: Callable[[Block], tuple[np.ndarray, float]]
    columns: Sequence[str]
    wrong_for: set[str] = field(default_factory=set)

    def __call__(self, block: Block) -> np.ndarray:
        """Return the weights (samples,)."""
        found, expected = self.find(block)
        n, share = found.shape[1], min(expected + MADE_FOR, 1.0)
        wrong = found.sum(axis=1) > n * share + CLEARLY * np.sqrt(n * share * (1 - share))
        self.wrong_for |= {name for name, many in zip(self.columns, wrong, strict=True) if many}
        return (~found[~wrong].any(axis=0)).astype(float)


def column_spikes(columns: Sequence[str]) -> Filter:
    """Return weights 0 where any column leaves its own neighbourhood: a first guess without a model.

    Each sample is compared with the median of six linear predictions from its four neighbours. The worst of
    each neighbourhood is replaced by it and the comparison repeated, so that a spike neither hides the next
    one nor flags a good one.
    """
    return Filter(lambda b: (_leaves_neighbourhood(np.array([b.data[c] for c in columns])), 0.0), columns)


def _leaves_neighbourhood(values: np.ndarray) -> np.ndarray:
    """Return which entries of columns (c, samples) do; each column is judged by itself."""
    bad = np.zeros(values.shape, dtype=bool)
    if values.shape[1] < WINDOW:
        return bad
    open_, x = np.arange(len(values)), values.copy()  # columns in which a spike may still be found
    for _ in range(ROUNDS):
        predicted = _predicted(x)
        jump = np.abs(x - predicted)
        jump[:, :2], jump[:, -2:] = EXTRAPOLATED * jump[:, :2], EXTRAPOLATED * jump[:, -2:]
        far = jump > SPIKE * np.maximum(1.4826 * medians(jump), 1e-15)[:, None]
        spiky = far.any(axis=1)
        if spiky.any():
            far[spiky] &= jump[spiky] > SPIKE * _usual(jump[spiky], MOSTLY_SPIKY) / SPIKY_STD
        worst = far & (jump == scipy.ndimage.maximum_filter1d(jump, 5))
        going_on = worst.any(axis=1)
        if not going_on.any():
            break
        x[worst] = predicted[worst]
        bad[open_] |= worst
        open_, x = open_[going_on], x[going_on]
    return bad


def _predicted(x: np.ndarray) -> np.ndarray:
    """Predict every entry of columns (c, samples) by its neighbours."""
    a2, a1, b1, b2 = x[:, :-4], x[:, 1:-3], x[:, 3:-1], x[:, 4:]
    lines = [
        a1 + b1,
        a2 + b2,
        4 * a1 - 2 * a2,
        4 * b1 - 2 * b2,
        (4 * a1 + 2 * b2) / 3,
        (2 * a2 + 4 * b1) / 3,
    ]
    (a1, a2, a3), (b1, b2, b3) = _ascending(*lines[:3]), _ascending(*lines[3:])
    third = np.minimum(np.minimum(a3, b3), np.minimum(np.maximum(a1, b2), np.maximum(a2, b1)))
    fourth = np.maximum(np.maximum(a1, b1), np.maximum(np.minimum(a2, b3), np.minimum(a3, b2)))
    predicted = np.empty_like(x)
    predicted[:, 2:-2] = (third + fourth) / 4  # the median of six, as sums of two
    ends = _from_inside(np.concatenate([x[:, :6], x[:, :-7:-1]]))
    predicted[:, :2], predicted[:, -2:] = ends[: len(x)], ends[len(x) :, ::-1]
    return predicted


def _ascending(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the least, the middle and the largest of three arrays, entry by entry."""
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.minimum(low, c), np.maximum(low, np.minimum(high, c)), np.maximum(high, c)


def _usual(jump: np.ndarray, percent: int) -> np.ndarray:
    """Return the usual size of jumps (c, samples) before, around or after each sample, the largest of these.

    Where a motion begins, only the neighbourhood after the sample is similar.
    """
    n, half = jump.shape[1], AROUND // 2
    if n < AROUND:
        return np.zeros_like(jump)
    # one row after the other, each mirrored at its ends: one call, and filters are fastest along one row
    wide = jump[:, np.r_[half:0:-1, :n, n - 2 : n - 2 - half : -1]]
    filtered = scipy.ndimage.percentile_filter(wide.ravel(), percent, size=AROUND, mode="nearest")
    filtered = filtered.reshape(wide.shape)
    about = filtered[:, half:-half]
    before = np.concatenate([np.repeat(about[:, :1], half, axis=1), about[:, :-half]], axis=1)
    after = np.concatenate([about[:, half:], np.repeat(about[:, -1:], half, axis=1)], axis=1)
    return np.maximum(np.maximum(before, about), after)


_AHEAD = np.linalg.pinv(np.vander(np.arange(1, 7), 3, increasing=True))[0]
"""Weights of the next six samples in the parabola through them; its prediction error is 2.05 sigma."""
_PAIRS = np.triu_indices(5, 1)
_OTHERS = np.array([[1, 2, 3, 4, 5], [0, 2, 3, 4, 5]])
_RUN = _OTHERS[:, _PAIRS[1]] - _OTHERS[:, _PAIRS[0]]
_REACH = np.array([[0], [1]]) - _OTHERS


def _from_inside(x: np.ndarray) -> np.ndarray:
    """Predict the first two of six samples (c, 6), which lack neighbours on one side.

    By Theil-Sen lines of the five others.
    """
    near = x[:, _OTHERS]
    slopes = np.sort((near[..., _PAIRS[1]] - near[..., _PAIRS[0]]) / _RUN, axis=2)
    middle = slopes[..., 4:6].mean(axis=2, keepdims=True)  # of ten
    return np.sort(near + middle * _REACH, axis=2)[..., 2]


def reject_spikes(
    residual: Callable[[Block], np.ndarray],
    covariance: np.ndarray,
    suspects: Weigh,
    channels: Sequence[str],
) -> Filter:
    """Return weights 0 for isolated spikes of any channel's residual against a running median, else 1.

    A smooth residual is kept: it is a gap, not an outlier. `covariance`: (n_channels, n_channels) of one
    sample's residual by the stated noise; the scale is the larger of it and of the block's own. `suspects`:
    samples of weight 0 take no part in median and scale (those of `column_spikes`, which do not change from
    one fit to the next). A channel with many more spikes than suspects flags none; `channels` names it.
    """
    stated = np.sqrt(np.diag(covariance))[:, None]

    def find(block: Block) -> tuple[np.ndarray, float]:
        r, good = residual(block), suspects(block) > 0
        suspected = 1.0 - float(good.mean())
        spike = np.zeros_like(r, dtype=bool)
        for _ in range(ROUNDS):
            before, (jump, scale, side) = spike, _jumps(r, good, stated)
            least = _least(jump / scale, spike & _abound(side, spike))
            spike = jump > least[:, None] * scale
            for k in np.flatnonzero(spike.any(axis=1)):
                at, here = np.arange(len(good)), np.flatnonzero(good)
                usual = np.interp(at, here, _usual(jump[k : k + 1, good], 50)[0])
                spike[k] &= jump[k] > least[k] * 1.4826 * usual
            if np.array_equal(spike, before):
                break
            if _abound(side, spike):  # spikes take no part in the scale of others
                good = good & ~spike.any(axis=0)
        return spike, suspected

    return Filter(find, channels)


def _abound(side: np.ndarray, spike: np.ndarray) -> bool:
    """Whether there are many spikes (n_channels, samples), each by itself; `side`: of the median, +1 or -1.

    Where neighbours are on the same side more often than by chance (2 sigma), something moves outside the
    model, such as a rail: that does not lower the limit for spikes.
    """
    pairs = spike[:, 1:] & spike[:, :-1]
    same = (side[:, 1:] * side[:, :-1] * pairs).sum()
    return bool(spike.any(axis=0).mean() >= ABOUND and same <= 2 * np.sqrt(pairs.sum()))


def _least(jump: np.ndarray, spike: np.ndarray) -> np.ndarray:
    """Return the jump (n_channels,), in standard deviations, above which a sample is a spike.

    Share and size of the spikes found tell how many smaller ones hide below `SPIKE`: from here on a jump is
    ODDS times likelier one of them, spread evenly up to twice the median, than normal noise.
    """
    least = np.full(len(jump), SPIKE)
    for k in np.flatnonzero(spike.any(axis=1)):
        density = spike[k].mean() / (4 * median(jump[k, spike[k]]))
        least[k] = min(SPIKE, np.sqrt(-2 * np.log(density * np.sqrt(2 * np.pi) / ODDS)))
    return least


def _jumps(r: np.ndarray, good: np.ndarray, stated: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far residuals (n_channels, samples) are off neighbours, each channel's scale, the side."""
    if good.sum() < WINDOW:
        good = np.ones_like(good)
    at = np.arange(len(good))
    clean = np.array([np.interp(at, at[good], row[good]) for row in r])
    middle = scipy.ndimage.median_filter(r[:, good], size=(1, WINDOW), mode="mirror")
    running = np.array([np.interp(at, at[good], row) for row in middle])
    off = [np.abs(r - near) for near in _expected(clean, running, good)]
    jump = np.where(good, np.min(off, axis=0), off[0])  # a suspect is compared with the median only
    scale = np.maximum(1.4826 * np.median(jump[:, good], axis=1, keepdims=True), stated)
    return jump, scale, np.sign(r - running)


def _expected(r: np.ndarray, median: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, ...]:
    """Predictions of a residual that is no spike: running median, line from either side (a kink), cubic.

    The two samples at either end, which have neighbours on one side only, may also go on as a parabola. Lines
    and curves go through `good` samples only; elsewhere the median stands for them.
    """
    left, right, cubic = median.copy(), median.copy(), median.copy()
    before, after = good[1:-1] & good[:-2], good[1:-1] & good[2:]
    left[:, 2:] = np.where(before, 2 * r[:, 1:-1] - r[:, :-2], median[:, 2:])
    right[:, :-2] = np.where(after, 2 * r[:, 1:-1] - r[:, 2:], median[:, :-2])
    around = good[1:-3] & good[3:-1] & good[:-4] & good[4:]
    bent = (4 * (r[:, 1:-3] + r[:, 3:-1]) - (r[:, :-4] + r[:, 4:])) / 6
    cubic[:, 2:-2] = np.where(around, bent, median[:, 2:-2])
    for at, step in ((0, 1), (1, 1), (-1, -1), (-2, -1)):
        inside = at + step * np.arange(1, len(_AHEAD) + 1)
        if len(good) > len(_AHEAD) + 1 and good[inside].all():
            cubic[:, at] = r[:, inside] @ _AHEAD
    return median, left, right, cubic
