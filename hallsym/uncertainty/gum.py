"""An uncertainty budget by the GUM: sources, combined and expanded uncertainty, shares.

JCGM 100:2008, "Evaluation of measurement data: Guide to the expression of uncertainty in measurement",
doi:10.59161/JCGM100-2008E. Pure arithmetic: nothing here knows of sensors or files.

>>> sources = (Source.rectangular("step", 0.5, "m"), Source.normal("noise", 0.3, "m"))
>>> round(Budget("x", "m", sources).expanded, 4)
0.8327
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite, sqrt
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

from hallsym.errors import InputError
from hallsym.shown import Shown

DIVISORS = {"rectangular": sqrt(3.0), "triangular": sqrt(6.0), "arcsine": sqrt(2.0)}
"""Half-width over standard uncertainty: JCGM 100, 4.3.7 and 4.3.9; JCGM 101, 6.4.6 (arcsine, U-shaped)."""
DISTRIBUTIONS = ("normal", "student", *DIVISORS)


@dataclass(frozen=True)
class Source:
    """One input quantity: standard uncertainty `std` in `unit`, and what a unit of it does to the result.

    `sensitivity`: d result / d input. `degrees_of_freedom`: how well `std` itself is known; infinite if it
    is stated. Make one with `normal`, `rectangular`, `triangular`, `arcsine` or `readings`.
    """

    name: str
    std: float
    unit: str
    distribution: str = "normal"
    sensitivity: float = 1.0
    degrees_of_freedom: float = inf

    def __post_init__(self) -> None:
        """Refuse what cannot be an uncertainty."""
        if self.distribution not in DISTRIBUTIONS:
            raise InputError(
                f"Distribution of source {self.name!r} must be one of {', '.join(DISTRIBUTIONS)}; "
                f"instead received {self.distribution!r}."
            )
        if not (isfinite(self.std) and self.std >= 0):
            raise InputError(
                f"Uncertainty of source {self.name!r} must be a number >= 0; instead received {self.std!r}."
            )
        if not isfinite(self.sensitivity):
            raise InputError(
                f"Sensitivity to source {self.name!r} must be a finite number; "
                f"instead received {self.sensitivity!r}."
            )
        if not self.degrees_of_freedom >= 1:
            raise InputError(
                f"Degrees of freedom of source {self.name!r} must be 1 or more; "
                f"instead received {self.degrees_of_freedom!r}."
            )

    @staticmethod
    def normal(name: str, uncertainty: float, unit: str, k: float = 1.0, **more: Any) -> "Source":
        """Normal: an uncertainty stated as `k` standard uncertainties (JCGM 100, 4.3.3)."""
        if not (isfinite(k) and k > 0):
            raise InputError(
                f"Coverage factor of source {name!r} must be a positive number; instead received {k!r}."
            )
        return Source(name, uncertainty / k, unit, "normal", **more)

    @staticmethod
    def rectangular(name: str, half_width: float, unit: str, **more: Any) -> "Source":
        """Anywhere within +-half_width, all places equally likely: half_width / sqrt(3)."""
        return Source(name, half_width / DIVISORS["rectangular"], unit, "rectangular", **more)

    @staticmethod
    def triangular(name: str, half_width: float, unit: str, **more: Any) -> "Source":
        """Within +-half_width, most likely in the middle: half_width / sqrt(6)."""
        return Source(name, half_width / DIVISORS["triangular"], unit, "triangular", **more)

    @staticmethod
    def arcsine(name: str, half_width: float, unit: str, **more: Any) -> "Source":
        """U-shaped, a sine of amplitude half_width at an unknown phase: half_width / sqrt(2)."""
        return Source(name, half_width / DIVISORS["arcsine"], unit, "arcsine", **more)

    @staticmethod
    def readings(name: str, values: Sequence[float], unit: str, **more: Any) -> "Source":
        """Mean of n repeated readings: s / sqrt(n), with n - 1 degrees of freedom (JCGM 100, 4.2)."""
        n = len(values)
        if n < 2:
            raise InputError(f"Readings of source {name!r} must be two or more to scatter; {n} given.")
        return Source.scatter(name, float(np.std(values, ddof=1)), n, unit, **more)

    @staticmethod
    def scatter(name: str, deviation: float, n: int, unit: str, **more: Any) -> "Source":
        """Mean of n readings whose experimental standard deviation is `deviation`: s / sqrt(n)."""
        if n < 2:
            raise InputError(f"Readings of source {name!r} must be two or more to scatter; {n} given.")
        more = {"degrees_of_freedom": n - 1.0, **more}
        return Source(name, deviation / sqrt(n), unit, "student", **more)

    @property
    def contribution(self) -> float:
        """u_i(y) = c_i u(x_i), signed, in the unit of the result."""
        return self.sensitivity * self.std

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Return n random errors of this source, shape (n,), in its unit: JCGM 101, Table 1."""
        if self.distribution == "student":  # 6.4.9.2: scaled and shifted t
            return self.std * rng.standard_t(self.degrees_of_freedom, n)
        if self.distribution == "normal":
            return self.std * rng.standard_normal(n)
        half = self.std * DIVISORS[self.distribution]
        if self.distribution == "rectangular":
            return rng.uniform(-half, half, n)
        if self.distribution == "triangular":
            return half * (rng.random(n) - rng.random(n))
        return half * np.sin(2 * np.pi * rng.random(n))


@dataclass(frozen=True, eq=False, repr=False)
class Budget(Shown):
    """Sources of one result and what follows from them; everything in `unit`, the result's.

    `coverage`: the factor k of the expanded uncertainty, 2 by default. `level`: instead, the probability
    that y +- U shall hold; k is then Student's t at the effective degrees of freedom. `correlation`:
    (n, n) correlation coefficients of the sources, independent if None. `value`: the result itself, if known.
    `turns`: the result is an angle that goes round, which people read in degrees.
    """

    quantity: str
    unit: str
    sources: tuple[Source, ...]
    coverage: float = 2.0
    level: float | None = None
    correlation: np.ndarray | None = None
    value: float | None = None
    turns: bool = False

    def __post_init__(self) -> None:
        """Refuse a coverage or a correlation that cannot be."""
        if not (isfinite(self.coverage) and self.coverage > 0):
            raise InputError(
                f"Coverage factor of {self.quantity} must be a positive number; "
                f"instead received {self.coverage!r}."
            )
        if self.level is not None and not 0 < self.level < 1:
            raise InputError(
                f"Level of {self.quantity} must be a probability between 0 and 1, such as 0.95; "
                f"instead received {self.level!r}."
            )
        if self.correlation is not None:
            _check_correlation(self.correlation, len(self.sources), self.quantity)

    @cached_property
    def contributions(self) -> np.ndarray:
        """c_i u(x_i) of each source, signed, shape (n,)."""
        return np.array([s.contribution for s in self.sources], dtype=float)

    @cached_property
    def variances(self) -> np.ndarray:
        """What each source adds to u_c^2, its half of every covariance included, shape (n,)."""
        u = self.contributions
        return u * u if self.correlation is None else u * (self.correlation @ u)  # (13), (16)

    @property
    def std(self) -> float:
        """Combined standard uncertainty u_c, (10) and (13)."""
        return sqrt(max(float(self.variances.sum()), 0.0))

    @property
    def shares(self) -> np.ndarray:
        """Share of each source in u_c^2, shape (n,), sum 1; below 0 where a correlation cancels."""
        total = float(self.variances.sum())
        return self.variances / total if total > 0 else np.zeros(len(self.sources))

    @property
    def degrees_of_freedom(self) -> float:
        """Effective degrees of freedom, Welch-Satterthwaite (G.2b); correlated sources count as one.

        The formula wants independent terms, so a group of correlated sources enters with its own variance
        and the least degrees of freedom within it.
        """
        total, below = float(self.variances.sum()), 0.0
        for group in self._groups():
            variance = float(self.variances[group].sum())
            below += variance**2 / min(self.sources[i].degrees_of_freedom for i in group)
        return inf if below <= 1e-15 * total**2 else total**2 / below

    @property
    def factor(self) -> float:
        """Coverage factor k: as stated, or Student's t of `level` (degrees of freedom truncated, G.4.1)."""
        if self.level is None:
            return self.coverage
        half, dof = 0.5 + 0.5 * self.level, self.degrees_of_freedom
        return float(stdtrit(max(np.floor(dof), 1.0), half) if isfinite(dof) else ndtri(half))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U = k u_c (18)."""
        return self.factor * self.std

    def ranked(self) -> list[tuple[Source, float]]:
        """Return the sources with their shares, the largest first."""
        order = np.argsort(-self.shares, kind="stable")
        return [(self.sources[k], float(self.shares[k])) for k in order]

    def to_dict(self) -> dict[str, Any]:
        """Return the budget as plain numbers in `unit`, for JSON."""
        return {
            "quantity": self.quantity,
            "unit": self.unit,
            "value": self.value,
            "standard_uncertainty": self.std,
            "degrees_of_freedom": _finite(self.degrees_of_freedom),
            "coverage_factor": self.factor,
            "level": self.level,
            "expanded_uncertainty": self.expanded,
            "sources": [
                {
                    "name": s.name,
                    "distribution": s.distribution,
                    "standard_uncertainty": s.std,
                    "unit": s.unit,
                    "sensitivity": s.sensitivity,
                    "degrees_of_freedom": _finite(s.degrees_of_freedom),
                    "contribution": abs(s.contribution),
                    "share": float(share),
                }
                for s, share in zip(self.sources, self.shares, strict=True)
            ],
            "correlation": None if self.correlation is None else self.correlation.tolist(),
        }

    def _groups(self) -> list[list[int]]:
        """Sources that hang together through correlations."""
        n = len(self.sources)
        if self.correlation is None:
            return [[i] for i in range(n)]
        from scipy.sparse.csgraph import connected_components

        label = connected_components(self.correlation != 0, directed=False)[1]
        return [np.flatnonzero(label == k).tolist() for k in range(label.max(initial=-1) + 1)]


def _check_correlation(matrix: np.ndarray, n: int, quantity: str) -> None:
    good = matrix.shape == (n, n) and np.all(np.isfinite(matrix)) and np.allclose(matrix, matrix.T)
    if not (good and np.allclose(np.diag(matrix), 1.0) and np.linalg.eigvalsh(matrix).min() >= -1e-8):
        raise InputError(
            f"Correlations of {quantity} must be coefficients from -1 to 1 that can hold together "
            "(a positive semi-definite matrix); check their signs and sizes."
        )


def _finite(value: float) -> float | None:
    return float(value) if isfinite(value) else None
