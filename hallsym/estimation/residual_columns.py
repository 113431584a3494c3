"""The residual of a model on a log beside functions that it may follow: what noise is to be told from.

The functions know no effect: curves and products over the pose, its motion, the state, temperature and time,
waves over what is periodic. A machine whose model is wrong leaves such a function; noise follows none.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import combinations, pairwise
from types import MappingProxyType

import numpy as np

from hallsym.estimation.decoding import columns_of
from hallsym.estimation.likelihood import Point
from hallsym.estimation.residual_noise import Residual, ResidualNoise, residual_noise
from hallsym.families.play import stop_operator
from hallsym.log import Log
from hallsym.log.batches import Weigh, batches
from hallsym.log.derived import extended
from hallsym.log.phase import wrapped
from hallsym.model import Model
from hallsym.model.arrays import on_arrays

ROOM = 8_000
"""Samples that are looked at: of three channels they know the standard deviation of white noise to 0.5 %."""
READINGS = 100_000
"""The same times the channels, of models of many channels."""
SHARE = 20
"""Samples for each function, at least: fewer functions are tried on a short log."""
CURVE, WAVES, TIMES, PLACES = 12, 12, 8, 4
"""Cosines over a coordinate, waves per period, cosines over the time of the log, and over two coordinates."""
MEMORIES = (0.05, 0.15, 0.4, 1.0)
"""Half-widths of the play that a residual may follow, over the standard deviation of the coordinate."""
STILL = 5.0
"""An axis that moves less than this many sigma of its noise (rms) is at rest.

Its logged place is then noise to 4 % of its variance, and that noise is in the residual too."""
SLOW = 5.0
"""Noise over what differences of neighbouring samples have of it, from which on it is a disturbance.

Noise that is correlated over 10 samples has 4.3 times as much (first order, simulated), over 14 samples 5."""
REACH = 2
"""Samples on either side between which a rate is taken: none of them is the sample itself."""
TURNS = 0.05
"""Part of the greatest rate within which the direction of motion turns over."""


def noise_left(
    log: Log,
    model: Model,
    p: np.ndarray,
    zeros: Mapping[int, np.ndarray],
    covariance: np.ndarray,
    sigma: Mapping[str, float],
    keep: Weigh | None = None,
) -> ResidualNoise | None:
    """Return the noise that a model with parameters `p` (n,) leaves on the runs of `zeros`.

    `zeros`: run -> zero deviations, as displacements. `covariance`: (K, K) that the noise `sigma` by column
    gives a residual; the ratio is against it. `keep`: weight of each sample. None where the log is too short
    to tell.
    """
    most = max(1, min(ROOM, READINGS // len(model.channels)))
    data, values, used = _read(log, model, p, zeros, sigma, keep, most)
    if not len(used) or not used.any():
        return None
    columns = np.array([row for row in _columns(model, data, sigma) if np.all(np.isfinite(row))])
    columns = columns.reshape(-1, len(used))[: int(used.sum()) // SHARE]
    found = Residual(values, covariance, data["run"], columns, used, bool(model.zeros))
    return residual_noise(found, model.channels)


def noise_at(
    log: Log, point: Point, sigma: Mapping[str, float], keep: Weigh | None = None
) -> ResidualNoise | None:
    """Return the noise that a fit leaves on its runs; `point`: of its cost at the optimum."""
    cost = point.cost
    zeros = dict(zip(cost.summary.runs, point.zeros, strict=True))
    return noise_left(log, cost.summary.model, point.p, zeros, point.covariance.mean(axis=0), sigma, keep)


def estimated_factor(left: ResidualNoise, point: Point, columns: Collection[str]) -> float:
    """Return by what the noise of `columns` must be multiplied for a residual to have the noise `left`.

    `point`: of the fit with the noise that `left` is a multiple of. 1 where the residual does not contradict
    the noise, and where what is left is no noise: waves, steps between levels, or something so slow that
    differences of neighbouring samples have next to nothing of it.
    """
    model, cost = point.cost.summary.model, point.cost
    own = np.array([c in columns for c in model.channels])
    precision = np.linalg.inv(point.covariance.mean(axis=0))
    readings = np.diag(np.where(own, cost.reading_variance, 0.0))
    if any(c in columns for c in model.references):  # what is not the readings' own is the references'
        readings = readings + point.covariance.mean(axis=0) - np.diag(cost.reading_variance)
    share = float(np.trace(precision @ readings)) / len(own)
    ratio = left.ratio if left.interval[0] > 1.0 and not left.bounded and left.ratio < SLOW else 1.0
    return float(np.sqrt(1.0 + (ratio**2 - 1.0) / max(share, 1e-300))) if share > 0 else 1.0


Data = dict[str, np.ndarray]


def _read(
    log: Log,
    model: Model,
    p: np.ndarray,
    zeros: Mapping[int, np.ndarray],
    sigma: Mapping[str, float],
    keep: Weigh | None,
    most: int,
) -> tuple[Data, np.ndarray, np.ndarray]:
    """Return columns, the residual (K, n) and which samples count, of the beginning of each fitted run."""
    wanted = dict.fromkeys(
        (*columns_of(model), *(c for c in ("temperature_degc", "t_s") if c in log.columns))
    )
    source = extended(log, model, sigma, model.named(p))
    left = dict.fromkeys(zeros, -(-most // max(len(zeros), 1)))
    parts: list[Data] = []
    residuals: list[np.ndarray] = []
    counted: list[np.ndarray] = []
    residual = _residual(model, p, zeros)
    for batch in batches(source, tuple(wanted)):
        for block, _ in batch.parts():
            n = min(left.get(block.run, 0), len(next(iter(block.data.values()))))
            if n == 0:
                continue
            left[block.run] -= n
            data = {c: v[:n] for c, v in block.data.items()}
            parts.append(data | {"run": np.full(n, block.run)})
            residuals.append(residual(block.run, data))
            counted.append(np.ones(n, bool) if keep is None else keep(block)[:n] > 0)
        if not any(left.values()):
            break
    if not parts:
        return {}, np.zeros((len(model.channels), 0)), np.zeros(0, bool)
    values = np.hstack(residuals)
    finite = np.isfinite(values).all(axis=0)
    joined = {c: np.concatenate([part[c] for part in parts]) for c in parts[0]}
    return joined, np.where(finite, values, 0.0), np.concatenate(counted) & finite


def _residual(
    model: Model, p: np.ndarray, zeros: Mapping[int, np.ndarray]
) -> Callable[[int, Data], np.ndarray]:
    read = on_arrays(model.reading)

    def residual(run: int, data: Data) -> np.ndarray:
        pose, state = ([data[c] for c in columns] for columns in (model.references, model.state))
        left = np.array([data[c] for c in model.channels]) - read(p, zeros[run], pose, state)[0]
        for k, c in enumerate(model.channels):
            if c in model.period:
                left[k] = wrapped(left[k], model.period[c])
        return left

    return residual


NONE: Mapping[str, float] = MappingProxyType({})


def _columns(model: Model, data: Data, sigma: Mapping[str, float] = NONE) -> Iterator[np.ndarray]:
    """Yield functions (n,) that a residual may follow, the most telling ones first."""
    made = {c.name for c in model.computed}
    data = data | {c: _at_rest(v, data["run"], sigma.get(c, 0.0)) for c, v in data.items() if c in sigma}
    moves = [c for c in model.references if _moves(data[c], sigma.get(c, 0.0))]
    place = {c: _beside(data, c) if "t_s" in data else data[c] for c in moves}
    turns = {c: 2 * np.pi / model.period[c] * place[c] for c in moves if c in model.period}
    lines = {c: _unit(place[c]) for c in moves if c not in turns}
    states = [c for c in dict.fromkeys((*model.state, "temperature_degc")) if c in data and c not in made]
    states = [c for c in states if c not in model.references and _moves(data[c], sigma.get(c, 0.0))]
    s = [_unit(data[c]) for c in states]
    q = [*lines.values(), *(f(k * u) for u in turns.values() for k in (1, 2) for f in (np.cos, np.sin))]
    yield from q
    yield from s
    yield from (a * x for a in s for x in q)
    rates = list(_rates(data, moves))
    for v, a in rates:
        yield from (v, np.tanh(v / TURNS), a)
    for k in range(2, WAVES + 1):
        yield from (f(k * u) for u in turns.values() for f in (np.cos, np.sin))
    time = [c for c in ("t_s",) if c in data and np.ptp(data[c]) > 0]
    for t in (_unit(data[c]) for c in time):
        yield from (np.cos(k * np.pi * (t + 1) / 2) for k in range(1, TIMES + 1))
        yield from (f * x for f in (t, t * t) for x in q)
    if time:
        yield from _within_runs(data, lines)
    yield from (a * b for a, b in combinations(s, 2))
    yield from (a * a for a in s)
    for k in range(2, CURVE + 1):
        yield from (np.cos(k * np.pi * (x + 1) / 2) for x in lines.values())
    yield from (a * a * x for a in s for x in q)
    for v, a in rates:
        yield from (w * x for w in (np.abs(v), v * np.abs(v), v, np.tanh(v / TURNS), a) for x in (1.0, *q))
    for x, y in combinations(lines.values(), 2):
        for j in range(1, PLACES + 1):
            yield from (
                np.cos(j * np.pi * (x + 1) / 2) * np.cos(k * np.pi * (y + 1) / 2)
                for k in range(1, PLACES + 1)
            )


def _within_runs(data: Data, lines: Data) -> Iterator[np.ndarray]:
    """Yield the time within a run and its square, and what coordinates remember of their direction."""
    runs = [slice(a, b) for a, b in pairwise(_edges(data["run"]))]
    t = np.concatenate([_unit(data["t_s"][s]) for s in runs])
    yield from (t, t * t)
    for x in lines.values():
        size = float(np.std(x))
        for width in MEMORIES:
            yield np.concatenate([stop_operator(x[s], width * size) for s in runs])


def _beside(data: Data, column: str) -> np.ndarray:
    """Return where the neighbours of each sample say that a coordinate is, by cubics through four of them.

    The noise of a sample's own coordinate is in its residual: places beyond a turning point are noise.
    """
    out = data[column].copy()
    for first, last in pairwise(_edges(data["run"])):
        x = data[column][first:last]
        if len(x) > 4:
            wide = np.concatenate([2 * x[0] - x[2:0:-1], x, 2 * x[-1] - x[-2:-4:-1]])
            out[first:last] = (4.0 * (wide[1:-3] + wide[3:-1]) - wide[:-4] - wide[4:]) / 6.0
    return out


def _edges(run: np.ndarray) -> list[int]:
    return [0, *(np.flatnonzero(np.diff(run)) + 1).tolist(), len(run)]


def _rates(data: Data, moves: Sequence[str]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield velocity and acceleration of each coordinate over their greatest values, run by run."""
    t = data.get("t_s")
    if t is None:
        return
    for c in moves:
        v = _slope(data[c], t, data["run"], REACH)
        a = _slope(v, t, data["run"], REACH + 1)  # one more, so that the sample itself has no part in it
        yield _over(v), _over(a)


def _slope(x: np.ndarray, t: np.ndarray, run: np.ndarray, reach: int) -> np.ndarray:
    """Slope between the samples `reach` before and after each, nil at the ends of a run."""
    out = np.zeros(len(x))
    if len(x) <= 2 * reach:
        return out
    inside = slice(reach, len(x) - reach)
    ahead, behind = slice(2 * reach, None), slice(0, -2 * reach)
    step = t[ahead] - t[behind]
    good = (run[ahead] == run[behind]) & (step > 0)
    out[inside] = np.where(good, (x[ahead] - x[behind]) / np.where(step > 0, step, 1.0), 0.0)
    return out


def _at_rest(x: np.ndarray, run: np.ndarray, sigma: float) -> np.ndarray:
    """Return where an axis was: in a run where all that moved it is noise, its mean."""
    _, index = np.unique(run, return_inverse=True)
    count = np.bincount(index)
    mean = np.bincount(index, x) / count
    still = np.bincount(index, (x - mean[index]) ** 2) / count <= (STILL * sigma) ** 2
    return np.where(still[index], mean[index], x)


def _moves(x: np.ndarray, sigma: float) -> bool:
    return len(x) > 0 and float(np.std(x)) > max(STILL * sigma, 1e-300)


def _unit(x: np.ndarray) -> np.ndarray:
    """Scale a column to -1 .. 1 over its range."""
    low, high = float(x.min()), float(x.max())
    return (x - 0.5 * (low + high)) / max(0.5 * (high - low), 1e-300)


def _over(x: np.ndarray) -> np.ndarray:
    return x / max(float(np.abs(x).max(initial=0.0)), 1e-300)
