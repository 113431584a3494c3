"""Propagation of distributions, as a check of the linear budget.

JCGM 101:2008, Supplement 1 to the GUM, "Propagation of distributions using a Monte Carlo method",
doi:10.59161/JCGM101-2008: draw every input from its distribution, evaluate the measurement function, and
compare the result with the linear one (clause 8) within a tolerance given by the digits of the uncertainty
(7.9.2).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.special import chdtri, ndtr

from hallsym.errors import InputError, require
from hallsym.estimation import Fit
from hallsym.estimation.prediction import reading_variance
from hallsym.uncertainty.gum import Budget
from hallsym.uncertainty.inputs import (
    Settings,
    independent_inputs,
    offsets_at_reset,
    slopes,
    zero_point,
)
from hallsym.uncertainty.position import place, position_budget

BATCH = 10_000
"""Trials per batch of the adaptive procedure: JCGM 101, 7.9.4 b."""
MOST, LEAST = 2_000_000, 10_000
"""Most trials of the adaptive procedure, fewest that may be asked for."""
FINER = 5.0
"""Ratio of the tolerance to the scatter required of the Monte Carlo result: JCGM 101, 8.2."""
PARTS = 20
"""Parts of a fixed number of trials, from which its own scatter is found."""
WIDEST = 8.0
"""Standard deviations within which Student's distribution is tabulated: beyond lies 1e-15."""

Measure = Callable[[np.random.Generator, int], np.ndarray]
"""`(generator, n) -> (n_outputs, n)` random results."""
Verdict = Literal["confirmed", "not confirmed", "undecided"]


@dataclass(frozen=True)
class Comparison:
    """The linear and the Monte Carlo result of one output, in its SI unit; `linear` is of the same `level`.

    `interval` is the probabilistically symmetric, `shortest` the shortest interval of probability `level`.
    `tolerance`: delta of 7.9.2 for `digits` significant digits. `scatter`: standard deviation of the Monte
    Carlo mean, u and both ends themselves. `differences`: linear minus Monte Carlo end, lower and upper.
    """

    linear: Budget
    level: float
    digits: int
    trials: int
    mean: float
    std: float
    interval: tuple[float, float]
    shortest: tuple[float, float]
    tolerance: float
    scatter: tuple[float, float, float, float]
    stable: bool

    @property
    def differences(self) -> tuple[float, float]:
        """How far each end of the linear interval is from the Monte Carlo one: d_low, d_high of (8.1)."""
        return self.linear.interval[0] - self.interval[0], self.linear.interval[1] - self.interval[1]

    @property
    def verdict(self) -> Verdict:
        """Confirmed where both ends agree within the tolerance; undecided where the trials are too few."""
        off = np.abs(self.differences)
        slack = 2.0 * np.array(self.scatter[2:])
        if np.all(off <= self.tolerance):
            return "confirmed" if self.stable or np.all(off + slack <= self.tolerance) else "undecided"
        return "not confirmed" if np.any(off - slack > self.tolerance) else "undecided"

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers in SI for JSON."""
        return {
            "quantity": self.linear.quantity,
            "unit": self.linear.unit,
            "verdict": self.verdict,
            "level": self.level,
            "trials": self.trials,
            "digits": self.digits,
            "tolerance": self.tolerance,
            "stable": self.stable,
            "linear": {
                "value": self.linear.value or 0.0,
                "standard_uncertainty": self.linear.std,
                "interval": list(self.linear.interval),
            },
            "monte_carlo": {
                "value": self.mean,
                "standard_uncertainty": self.std,
                "interval": list(self.interval),
                "shortest_interval": list(self.shortest),
                "scatter": dict(zip(("value", "std", "low", "high"), self.scatter, strict=True)),
            },
            "differences": list(self.differences),
        }


def tolerance(std: float, digits: int = 2) -> float:
    """Return delta = 10^l / 2, where `std` = c 10^l with an integer c of `digits` digits (7.9.2)."""
    if not (np.isfinite(std) and std > 0):
        return 0.0
    mantissa = f"{std:.{digits - 1}e}"  # rounds .0996 up to .10 before the exponent is read
    return 0.5 * 10.0 ** (int(mantissa.partition("e")[2]) - digits + 1)


def propagate(
    measure: Measure,
    linear: Sequence[Budget],
    rng: np.random.Generator,
    *,
    trials: int | None = None,
    level: float = 0.95,
    digits: int = 2,
) -> list[Comparison]:
    """Return one comparison per output of `measure` with the linear results.

    `trials`: a fixed number, or None for the adaptive procedure of 7.9.4, which adds batches until the mean,
    u and both ends of the interval are stable within a fifth of the tolerance, at most `MOST` trials.
    """
    require(0 < level < 1, "Level of Monte Carlo", "a probability such as 0.95", level)
    require(digits in (1, 2, 3), "Significant digits of Monte Carlo", "1, 2 or 3", digits)
    require(trials is None or trials >= LEAST, "Monte Carlo trials", f"{LEAST} or more", trials)
    if trials is None:
        size = max(BATCH, int(np.ceil(100 / (1 - level))))
        sizes = [size] * max(2, MOST // size)
    else:
        sizes = [len(part) for part in np.array_split(np.arange(trials), max(PARTS, -(-trials // BATCH)))]
    parts: list[np.ndarray] = []
    rows: list[np.ndarray] = []
    for n in sizes:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            values = np.atleast_2d(measure(rng, n))
        parts.append(np.where(np.isfinite(values), values, np.finfo(float).max ** 0.25))
        rows.append(_summary(parts[-1], level))
        if trials is None and len(rows) > 1:
            wanted = np.array([tolerance(u, digits) for u in np.mean(rows, axis=0)[1]])
            if np.all(2 * _scatter(rows) <= wanted / FINER):
                break
    everything, scatter = np.concatenate(parts, axis=1), _scatter(rows)
    whole = _summary(everything, level)
    out = []
    for k, said in enumerate(linear):
        mean, std, low, high = (float(v) for v in whole[:, k])
        delta = tolerance(std, digits)
        out.append(
            Comparison(
                said, level, digits, everything.shape[1], mean, std, (low, high),
                _shortest(everything[k], level), delta, tuple(scatter[:, k].tolist()),
                bool(np.all(2 * scatter[:, k] <= delta / FINER)),
            )
        )  # fmt: skip
    return out


def _scatter(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return the standard deviation of the mean of `_summary` over the parts, (4, n_outputs)."""
    return np.asarray(np.std(rows, axis=0, ddof=1) / np.sqrt(len(rows)))


def _summary(values: np.ndarray, level: float) -> np.ndarray:
    """Mean, standard deviation and ends of the probabilistically symmetric interval, (4, n_outputs)."""
    tail = 0.5 - 0.5 * level
    low, high = np.quantile(values, (tail, 1 - tail), axis=1)
    return np.array([values.mean(axis=1), values.std(axis=1, ddof=1), low, high])


def _shortest(values: np.ndarray, level: float) -> tuple[float, float]:
    """Shortest interval that holds `level` of the trials (7.7.4)."""
    ordered = np.sort(values)
    inside = int(np.floor(level * len(ordered) + 0.5))
    widths = ordered[inside:] - ordered[: len(ordered) - inside]
    k = int(np.argmin(widths))
    return float(ordered[k]), float(ordered[k + inside])


# -- what is propagated ----------------------------------------------------------------------------------


def budget_monte_carlo(
    budget: Budget, rng: np.random.Generator, *, trials: int | None = None, level: float = 0.95, **more: Any
) -> Comparison:
    """Return the comparison for a stand-alone budget: the sum of its sources, each from its distribution."""
    correlated = np.zeros(len(budget.sources), dtype=bool)
    if budget.correlation is not None:
        correlated = np.any((budget.correlation != 0) & ~np.eye(len(correlated), dtype=bool), axis=1)
    for source, together in zip(budget.sources, correlated, strict=True):
        if together and source.distribution != "normal":
            raise InputError(
                f"Source {source.name!r} is correlated and {source.distribution}; Monte Carlo draws "
                "correlated sources only where they are normal."
            )
    joint = np.flatnonzero(correlated)
    root = _root(budget.correlation[np.ix_(joint, joint)]) if budget.correlation is not None else None
    value = budget.value or 0.0

    def measure(rng: np.random.Generator, n: int) -> np.ndarray:
        total = np.full(n, value)
        for k, source in enumerate(budget.sources):
            if not correlated[k]:
                total += source.sensitivity * source.draw(rng, n)
        if root is not None:
            total += budget.contributions[joint] @ (root @ rng.standard_normal((len(joint), n)))
        return total

    said = [replace(budget, level=level)]
    return propagate(measure, said, rng, trials=trials, level=level, **more)[0]


def position_monte_carlo(
    fit: Fit,
    at: Mapping[str, float] | None = None,
    settings: Settings | None = None,
    *,
    rng: np.random.Generator,
    trials: int | None = None,
    level: float = 0.95,
    **more: Any,
) -> dict[str, Comparison]:
    """Return one comparison per pose coordinate: decode through the model itself, parameters drawn too.

    `at` and `settings` as in `position_budget`; `trials`, `level`, `digits` as in `propagate`.
    """
    settings = settings or Settings()
    linear = [replace(b, level=level) for b in position_budget(fit, at, settings).values()]
    found = propagate(
        decoded_at_random(fit, at or {}, settings), linear, rng, trials=trials, level=level, **more
    )
    return dict(zip(fit.model.pose, found, strict=True))


def decoded_at_random(fit: Fit, at: Mapping[str, float], settings: Settings) -> Measure:
    """Return the measurement function of a position: zeroing, reading and decoding with random inputs."""
    model, listed = fit.model, independent_inputs(fit, settings)
    pose, state = place(model, at)
    left = slopes(fit, pose[:, None], state[:, None], settings).left
    q0, s0 = zero_point(model, settings)
    still = np.zeros(len(model.offsets))
    reading, first = (model.readings(fit.values, *x) for x in ((pose, state), (q0, s0)))
    base = {
        "reading": reading, "state": state, "scale": np.zeros(len(pose)),
        "zero reading": first, "zero state": s0, "zero pose": q0,
    }  # fmt: skip
    weight, root = 1 / reading_variance(fit), _root(fit.covariance)
    stretch = _stretch(fit.degrees_of_freedom)
    offsets = offsets_at_reset(model) if model.offsets else None
    of_model = np.sqrt(sum((v[0] for v in left.values()), np.zeros(len(pose))))

    def measure(rng: np.random.Generator, n: int) -> np.ndarray:
        x = {name: np.repeat(values[:, None], n, axis=1) for name, values in base.items()}
        for entry in listed:
            error = entry.source.draw(rng, n)
            for name, index in entry.places:
                x[name][index] += error
        spread = root @ rng.standard_normal((len(root), n))
        p = fit.values[:, None] + (spread if stretch is None else spread * stretch(rng, n))
        d = still
        if offsets is not None:
            (d,) = offsets(p, x["zero reading"], x["zero pose"], x["zero state"], weight)
        q = model.decode(p, d, x["reading"], x["state"], weight)
        q = q + x["scale"] * (q - q0[:, None])
        return q + of_model[:, None] * rng.standard_normal(q.shape) if left else q

    return measure


def _stretch(dof: np.ndarray) -> Callable[[np.random.Generator, int], np.ndarray] | None:
    """Return factors from normal errors of n parameters to Student's: `draw(rng, trials) -> (n, trials)`.

    Multivariate t, JCGM 102, 5.3.2.4, but each parameter with its own degrees of freedom `dof` (n,): all take
    the same quantile of their chi-square, since their variances come from the same runs.
    """
    if not np.any(np.isfinite(dof)):
        return None
    z = np.linspace(-WIDEST, WIDEST, 601)
    tail, few = ndtr(-z), np.where(np.isfinite(dof), dof, 1.0)[:, None]
    table = np.where(np.isfinite(dof)[:, None], -0.5 * np.log(chdtri(few, tail) / few), 0.0)

    def draw(rng: np.random.Generator, n: int) -> np.ndarray:
        drawn = rng.standard_normal(n)
        return np.exp([np.interp(drawn, z, row) for row in table])

    return draw


def _root(covariance: np.ndarray) -> np.ndarray:
    """A square root of a covariance that may be singular, scaled so that small entries keep digits."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    return safe[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
