"""Position and speed at the time that a controller asks for: a second-order observer behind the decoder.

Sample n has the pose z and a time dt after the one before. With the position x and the speed v,

    x' = x + v dt,   r = z - x',   x = x' + g r,   v = v + (h / T) r,   with

    g = 1 - q^2,   h = (1 - q)^2,   q = exp(-w T),

the critically damped filter with both poles at q (fading memory of degree 1: Zarchan, Musoff, Fundamentals of
Kalman Filtering, chapter 9), w = 2 pi times its bandwidth, T the period of the samples. At a constant speed
it leaves no error; at an acceleration a, one sample ahead, a T^2 / h.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, exp, log, pi

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Decoupler, Entry, short, unit
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit
from hallsym.families.recording import as_read
from hallsym.log import Log

LONGEST = 3.0
"""Periods of the samples after which a gap starts the observer anew: with `LEAST` it is stable up to
there."""
LEAST = 0.25
"""Least q: beyond that bandwidth the speed follows the noise of one sample to the next."""
SETTLED = 0.05
"""Share of a wrong start that may be left where a prediction is called settled."""
TRIED = 60
"""Bandwidths that are tried on a log, from a thousandth of the sampling rate to the largest."""
SPEEDS = 4
"""Ranges of speed, with as many samples each, over which the error on a log is stated."""


@dataclass(frozen=True)
class Observer:
    """Bandwidth [Hz], period of the samples [s], and the time [s] from the pose to its timestamp."""

    bandwidth_hz: float
    period_s: float
    latency_s: float = 0.0
    said: tuple[str, ...] = ()
    """Sentences for header and report: what it leaves by speed."""

    def __post_init__(self) -> None:
        """Refuse what no observer has."""
        if not (
            0 < self.period_s < np.inf and 0 < self.bandwidth_hz < np.inf and 0 <= self.latency_s < np.inf
        ):
            raise InputError(
                "An observer needs a bandwidth and a period above 0, and a latency of 0 or more."
            )
        if self.q < LEAST:
            most = -log(LEAST) / (2 * pi * self.period_s)
            raise InputError(
                f"A bandwidth of {self.bandwidth_hz:g} Hz is too much for samples every {self.period_s:g} s: "
                f"the speed would follow their noise; give at most {most:.3g} Hz."
            )

    @property
    def q(self) -> float:
        """Both poles of the filter."""
        return exp(-2 * pi * self.bandwidth_hz * self.period_s)

    @property
    def position(self) -> float:
        """g: share of a new pose in the position."""
        return 1 - self.q**2

    @property
    def speed(self) -> float:
        """h / T [1/s]: what a new pose adds to the speed."""
        return (1 - self.q) ** 2 / self.period_s

    @property
    def lag(self) -> float:
        """T^2 / h [s2]: what an acceleration leaves one sample ahead, per acceleration."""
        return self.period_s**2 / (1 - self.q) ** 2

    @property
    def settled(self) -> int:
        """Samples after a start until a prediction is called settled: q^n (1 + n (1 - q)) is `SETTLED`
        then."""
        n = 1
        while self.q**n * (1 + n * (1 - self.q)) > SETTLED:
            n = max(n + 1, ceil(1.01 * n))
        return n

    def behind(self, d: Decoupler, reach: dict[str, float]) -> Decoupler:
        """Return a decoupler with this observer behind it; `reach`: largest travel of each coordinate."""
        longest = LONGEST * self.period_s
        entries = (
            # a share and a bounded speed: whatever table is accepted, the observed position does not grow
            Entry("observer_position", self.position, "1", "share of a new pose in the position", "share"),
            Entry("observer_speed", self.speed, "1/s", "what a new pose adds to the observed speed", "sign"),
            Entry("observer_settled", float(self.settled), "1", "samples until one is settled", "sign"),
            Entry("longest_gap", longest, "s", "longest time between samples, and ahead of the last", "sign"),
            Entry("latency", self.latency_s, "s", "from the pose to the timestamp of its sample"),
            *(
                Entry(f"fastest_{short(c)}", reach[c] / longest, f"{unit(c)}/s", "largest speed", "sign")
                for c in d.pose
            ),
        )  # fmt: skip
        symbols = {**d.symbols, **{e.name: ca.SX.sym(e.name) for e in entries}}
        return replace(
            d, table=(*d.table, *entries), symbols=symbols, observed=True, said=(*d.said, *self.said)
        )


def _observed(
    observers: "Sequence[Observer]", t: np.ndarray, pose: np.ndarray, period: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and speeds (n_pose, n_observers, s) of poses (n_pose, s) at times t (s,).

    `period` (n_pose,): of coordinates that repeat, infinite of others.
    """
    g, h = np.array([[o.position, o.speed] for o in observers]).T
    x, v = np.repeat(pose[:, :1], len(observers), axis=1), np.zeros((len(pose), len(observers)))
    xs, vs = [x], [v]
    for k in range(1, pose.shape[1]):
        ahead = x + v * (t[k] - t[k - 1])
        r = _around(pose[:, k : k + 1] - ahead, period[:, None])
        x, v = _around(ahead + g * r, period[:, None]), v + h * r
        xs.append(x)
        vs.append(v)
    return np.moveaxis(np.array(xs), 0, -1), np.moveaxis(np.array(vs), 0, -1)


def _around(v: np.ndarray, period: np.ndarray) -> np.ndarray:
    """Return values within half a period of zero, of what repeats."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(np.isfinite(period), v - period * np.round(v / period), v))


@dataclass(frozen=True)
class Followed:
    """What is left of a pose coordinate [its unit] by range of speed, rms: the last one, and predicted."""

    column: str
    speeds: tuple[float, ...]
    """Upper end of each range [unit/s]."""
    last: tuple[float, ...]
    predicted: tuple[float, ...]


def observer_of(
    fit: Fit,
    log_: Log,
    *,
    bandwidth_hz: float | None = None,
    latency: float = 0.0,
) -> Observer:
    """Return the observer that leaves least of the reference of a log, rms over the accuracy of each
    coordinate.

    `bandwidth_hz`: taken instead. Raises `InputError` where a log has too few samples.
    """
    runs = _runs(fit, log_)
    period = float(f"{np.median(np.concatenate([np.diff(t) for t, *_ in runs])):.6g}")
    if bandwidth_hz is not None:
        best = Observer(bandwidth_hz, period, latency)
    else:
        most = -log(LEAST * 1.001) / (2 * pi * period)
        tried = [
            Observer(float(f"{hz:.3g}"), period, latency) for hz in np.geomspace(1e-3 / period, most, TRIED)
        ]
        floor = np.array([fit.noise_floor.get(c) or 1.0 for c in fit.model.pose])[:, None, None]
        left = [np.sum((error / floor) ** 2, axis=(0, 2)) / np.sum(counts, axis=1)
                for _, _, error, counts in (_errors(fit, run, tried, period) for run in runs)]  # fmt: skip
        best = tried[int(np.argmin(np.nanmean(left, axis=0)))]
    said = [
        f"{one.column} predicted {1e3 * period:.3g} ms ahead is off, rms, by {one.predicted[-1]:.2g} "
        f"{unit(one.column)} at up to {one.speeds[-1]:.2g} {unit(one.column)}/s, and by "
        f"{one.predicted[0]:.2g} at up to {one.speeds[0]:.2g}; the last pose held by {one.last[-1]:.2g} and "
        f"{one.last[0]:.2g}, of the log with the noise of its reference."
        for one in followed(fit, log_, best)
    ]
    about = (
        f"decoupler_predict(): an observer with a bandwidth of {best.bandwidth_hz:.3g} Hz for samples every "
        f"{1e3 * period:.4g} ms; at a constant speed it leaves nothing, at an acceleration a, one "
        f"sample ahead, a * {best.lag:.3g} s2."
    )
    return replace(best, said=(about, *said))


def followed(fit: Fit, log_: Log, observer: Observer) -> tuple[Followed, ...]:
    """Return what an observer, one sample ahead, and the last pose leave of each coordinate by speed."""
    found = [_errors(fit, run, [observer], observer.period_s) for run in _runs(fit, log_)]
    speed = np.hstack([f[0][:, f[3][0]] for f in found])
    last = np.hstack([f[1][:, f[3][0]] for f in found])
    predicted = np.hstack([f[2][:, 0, f[3][0]] for f in found])
    out = []
    for k, c in enumerate(fit.model.pose):
        order = np.array_split(np.argsort(np.abs(speed[k])), SPEEDS)
        rms = [[float(np.sqrt(np.mean(e[k, i] ** 2))) for i in order] for e in (last, predicted)]
        ends = tuple(float(np.abs(speed[k, i]).max()) for i in order)
        out.append(Followed(c, ends, tuple(rms[0]), tuple(rms[1])))
    return tuple(out)


def _runs(fit: Fit, log_: Log) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return times, decoded poses and references of the runs of a log, each from its own zero."""
    read, out = as_read(log_, fit.model, fit.corrections), []
    found, t = fit.predict(read), read.array("t_s")
    rows = [found[c] for c in fit.model.pose], [read.array(c) for c in fit.model.references]
    for number in np.unique(found["run"]):
        own = found["run"] == number
        if own.sum() < MOST_SHORT:
            continue
        pose, reference = (np.array(values)[:, own] for values in rows)
        off = _around(pose - reference, _periods(fit)[:, None])
        pose = pose - off.mean(axis=1, keepdims=True)  # as after a reset at a known pose
        out.append((t[own], pose, reference))
    if not out:
        raise InputError(
            f"No run of {log_.name} has {MOST_SHORT} samples; an observer is found from longer ones."
        )
    return out


def _errors(
    fit: Fit, run: tuple[np.ndarray, np.ndarray, np.ndarray], observers: Sequence[Observer], ahead: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return speeds and errors of the last pose kept (n_pose, s), of predictions (n_pose, n, s) of a run.

    And which samples count (n, s): after a start, half a run at most, and whose time ahead the run covers.
    """
    (t, pose, reference), periods = run, _periods(fit)
    x, v = _observed(observers, t, pose, periods)
    smooth = np.array([
        np.unwrap(r, period=p) if np.isfinite(p) else r for r, p in zip(reference, periods, strict=True)
    ])  # fmt: skip
    wanted = np.array([np.interp(t + ahead, t, r) for r in smooth])
    inside = t + ahead <= t[-1] + 1e-9
    counts = np.array([inside & (np.arange(len(t)) >= min(o.settled, len(t) // 2)) for o in observers])
    error = _around(x + v * ahead - wanted[:, None], periods[:, None, None])
    error = np.where(counts[None], error, 0.0)
    return np.gradient(smooth, t, axis=1), _around(pose - wanted, periods[:, None]), error, counts


def _periods(fit: Fit) -> np.ndarray:
    return np.array([fit.model.period.get(c, np.inf) for c in fit.model.pose])


MOST_SHORT = 20
"""Samples that a run must have."""
