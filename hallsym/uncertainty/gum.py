"""An uncertainty budget by the GUM: sources, combined and expanded uncertainty, shares.

JCGM 100:2008, "Evaluation of measurement data: Guide to the expression of uncertainty in measurement",
doi:10.59161/JCGM100-2008E. A budget is read from TOML, one `[[source]]` table per input, the unit of a number
in its key; a curve that the machine follows adds its error.

>>> sources = (Source.rectangular("step", 0.5, "m"), Source.normal("noise", 0.3, "m"))
>>> round(Budget("x", "m", sources).expanded, 4)
0.8327
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isfinite, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtrit

from hallsym.errors import InputError, nearest, require
from hallsym.records import plain
from hallsym.shown import Shown
from hallsym.toml import Table, unit_of
from hallsym.trajectory import Curve

DIVISORS = {"rectangular": sqrt(3.0), "triangular": sqrt(6.0), "arcsine": sqrt(2.0)}
"""Half-width over standard uncertainty: JCGM 100, 4.3.7 and 4.3.9; JCGM 101, 6.4.6 (arcsine, U-shaped)."""
QUANTILES: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "rectangular": lambda u: 2 * u - 1,
    "triangular": lambda u: np.where(u < 0.5, np.sqrt(2 * u) - 1, 1 - np.sqrt(2 * (1 - u))),
    "arcsine": lambda u: -np.cos(np.pi * u),
    "normal": lambda u: ndtri(np.clip(u, 1e-12, 1 - 1e-12)),
}
"""Inverse of the distribution function, over the half-width, of a normal one over 1 sigma."""
DISTRIBUTIONS = ("normal", "student", *DIVISORS)


@dataclass(frozen=True)
class Source:
    """One input quantity: standard uncertainty `std` in `unit`, and its sensitivity.

    `sensitivity`: d result / d input. `degrees_of_freedom`: of `std`; infinite if it is stated. Make one with
    `normal`, `rectangular` or `readings`.
    """

    name: str
    std: float
    unit: str
    distribution: str = "normal"
    sensitivity: float = 1.0
    degrees_of_freedom: float = inf

    def __post_init__(self) -> None:
        """Refuse what cannot be an uncertainty."""
        known = ", ".join(DISTRIBUTIONS)
        std, slope, dof = self.std, self.sensitivity, self.degrees_of_freedom
        require(
            self.distribution in DISTRIBUTIONS,
            f"Distribution of source {self.name!r}",
            f"one of {known}",
            self.distribution,
        )
        require(isfinite(std) and std >= 0, f"Uncertainty of source {self.name!r}", "a number >= 0", std)
        require(isfinite(slope), f"Sensitivity to source {self.name!r}", "a finite number", slope)
        require(dof >= 1, f"Degrees of freedom of source {self.name!r}", "1 or more", dof)

    @staticmethod
    def normal(name: str, uncertainty: float, unit: str, k: float = 1.0, **more: Any) -> "Source":
        """Normal: an uncertainty stated as `k` standard uncertainties (JCGM 100, 4.3.3)."""
        require(isfinite(k) and k > 0, f"Coverage factor of source {name!r}", "a positive number", k)
        return Source(name, uncertainty / k, unit, "normal", **more)

    @staticmethod
    def rectangular(name: str, half_width: float, unit: str, **more: Any) -> "Source":
        """Anywhere within +-half_width, all places equally likely: half_width / sqrt(3)."""
        return Source(name, half_width / DIVISORS["rectangular"], unit, "rectangular", **more)

    @staticmethod
    def readings(name: str, values: Sequence[float], unit: str, **more: Any) -> "Source":
        """Mean of n repeated readings: s / sqrt(n), with n - 1 degrees of freedom (JCGM 100, 4.2)."""
        n = len(values)
        if n < 2:
            raise InputError(f"Readings of source {name!r} must be two or more to scatter; {n} given.")
        more = {"degrees_of_freedom": n - 1.0, **more}
        return Source(name, float(np.std(values, ddof=1)) / sqrt(n), unit, "student", **more)

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
        return self.std * DIVISORS[self.distribution] * QUANTILES[self.distribution](rng.random(n))


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
        k, level = self.coverage, self.level
        require(isfinite(k) and k > 0, f"Coverage factor of {self.quantity}", "a positive number", k)
        wanted = "a probability between 0 and 1, such as 0.95"
        require(level is None or 0 < level < 1, f"Level of {self.quantity}", wanted, level)
        if (matrix := self.correlation) is None:
            return
        n = len(self.sources)
        good = matrix.shape == (n, n) and np.all(np.isfinite(matrix)) and np.allclose(matrix, matrix.T)
        if not (good and np.allclose(np.diag(matrix), 1.0) and np.linalg.eigvalsh(matrix).min() >= -1e-8):
            raise InputError(
                f"Correlations of {self.quantity} must be coefficients from -1 to 1 that can hold together "
                "(a positive semi-definite matrix); check their signs and sizes."
            )

    @cached_property
    def contributions(self) -> np.ndarray:
        """c_i u(x_i) of each source, signed, shape (n,)."""
        return np.array([s.contribution for s in self.sources], dtype=float)

    @cached_property
    def variances(self) -> np.ndarray:
        """Contribution of each source to u_c^2, with half of each of its covariances, shape (n,)."""
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

        The formula requires independent terms, so a group of correlated sources enters with its variance and
        its least degrees of freedom.
        """
        total, below = float(self.variances.sum()), 0.0
        for group in self._groups():
            variance = float(self.variances[group].sum())
            below += variance**2 / min(self.sources[i].degrees_of_freedom for i in group)
        return inf if below <= 1e-15 * total**2 else total**2 / below

    @property
    def factor(self) -> float:
        """Coverage factor k: as stated, or Student's t of `level`."""
        return self.coverage if self.level is None else float(students(self.level, self.degrees_of_freedom))

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U = k u_c (18)."""
        return self.factor * self.std

    @property
    def interval(self) -> tuple[float, float]:
        """y -+ U; y counts as 0 where it is not known."""
        value, half = self.value or 0.0, self.expanded
        return value - half, value + half

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
            "degrees_of_freedom": plain(self.degrees_of_freedom),
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
                    "degrees_of_freedom": plain(s.degrees_of_freedom),
                    "contribution": abs(s.contribution),
                    "share": float(share),
                }
                for s, share in zip(self.sources, self.shares, strict=True)
            ],
            "correlation": None if self.correlation is None else self.correlation.tolist(),
        }

    def _groups(self) -> list[list[int]]:
        """Groups of correlated sources."""
        n = len(self.sources)
        if self.correlation is None:
            return [[i] for i in range(n)]
        from scipy.sparse.csgraph import connected_components

        label = connected_components(self.correlation != 0, directed=False)[1]
        return [np.flatnonzero(label == k).tolist() for k in range(label.max(initial=-1) + 1)]


def students(level: float, degrees_of_freedom: float | np.ndarray) -> np.ndarray:
    """Return Student's t of a level, (...,); degrees of freedom are truncated (G.4.1) or infinite."""
    half, dof = 0.5 + 0.5 * level, np.asarray(degrees_of_freedom)
    few = np.maximum(np.floor(np.minimum(dof, 1e9)), 1.0)
    return np.where(np.isfinite(dof), stdtrit(few, half), ndtri(half))


# -- a curve that the machine follows ----------------------------------------------------------------------

CURVE = "curve"
"""Name of the source that a curve is."""


def with_curve(budget: Budget, curve: Curve, column: str | None = None) -> Budget:
    """Return a budget with the error of a curve as one more source; of lengths where no `column` is named.

    The largest error counts whole as a standard uncertainty in every length that the curve moves:
    Micromachines 2019, 10(9), 597, Eq. (15), doi:10.3390/mi10090597.

    Raises `InputError` for a budget that is not of a length and a curve whose error is not known.
    """
    if column is None and budget.unit != "m":
        raise InputError(
            f"A curve adds to a budget of a length; that of {budget.quantity!r} is in {budget.unit}."
        )
    if any(source.name == CURVE for source in budget.sources):
        raise InputError(f"The budget of {budget.quantity!r} has a source {CURVE!r} already; rename it.")
    is_angle = column is not None and column.endswith("_rad")
    error = curve.source.get("max_error_rad") if is_angle else curve.max_error_m
    if error is None:
        raise InputError(
            f"The curve does not state its error in {'angle' if is_angle else 'position'}; make it with "
            "'hallsym trajectory', which does."
        )
    correlation = budget.correlation
    if correlation is not None:
        n = len(correlation)
        correlation = np.block([[correlation, np.zeros((n, 1))], [np.zeros((1, n)), np.ones((1, 1))]])
    sources = (*budget.sources, Source.normal(CURVE, float(error), budget.unit))
    return replace(budget, sources=sources, correlation=correlation)


# -- a budget file -----------------------------------------------------------------------------------------

SIZES: Mapping[str, tuple[tuple[str, ...], float]] = {
    "std": (("normal", "student"), 1.0),
    "expanded": (("normal", "student"), 1.0),
    "half_width": (tuple(DIVISORS), 1.0),
    "full_width": (tuple(DIVISORS), 0.5),
    "resolution": (("rectangular",), 0.5),
    "readings": (("student",), 1.0),
}
"""Keys for the size of a source: exactly one per source, with its unit (`half_width_nm`). The distributions
that it may have, the default first, and the half-width or standard uncertainty over what is stated."""
TOP = ("quantity", "unit", "coverage_factor", "level", "source", "correlation")
OTHERS = ("name", "distribution", "coverage_factor", "degrees_of_freedom")


def read_budget(path: str | Path) -> tuple[Budget, str | None]:
    """Read a stand-alone budget; returns it in SI and the unit in which the file wants it read.

    Raises `InputError` for a missing file, unknown keys, distributions and units, and impossible numbers.
    """
    file = Table.read(path, "Budget file", TOP)
    made = [_source(entry) for entry in file.tables("source")]
    if not made:
        raise InputError(f"In {file.where} at least one [[source]] is needed; there is none.")
    names = [source.name for source, _, _ in made]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"In {file.where} two sources are called {twice[0]!r}; give each its own name.")
    results = {result for _, result, _ in made}
    if len(results) > 1:
        raise InputError(
            f"Sources of {file.where} must all act on one result; these act on "
            f"{' and '.join(sorted(results))}: give 'sensitivity_nm_per_urad = ...' where a source has "
            "another unit than the result."
        )
    coverage, level = coverage_of(file)
    unit, asked = results.pop(), {asked for _, _, asked in made}
    shown = file.text("unit") if "unit" in file else asked.pop() if len(asked) == 1 else None
    if shown is not None and unit_of(shown, file.where)[0] != unit:
        raise InputError(f"'unit' of {file.where} must be a unit of the result ({unit}); it is {shown!r}.")
    budget = Budget(
        quantity=file.text("quantity", Path(path).stem),
        unit=unit,
        sources=tuple(source for source, _, _ in made),
        coverage=coverage,
        level=level,
        correlation=_correlation(file, names),
    )
    return budget, shown


def _source(entry: Table) -> tuple[Source, str, str]:
    """Return a source in SI, the SI unit of the result it acts on, and the unit its result is given in."""
    if "name" not in entry:
        raise InputError(f"Every [[source]] needs a 'name'; {entry.where} has none.")
    name = entry.text("name")
    where = f"source {name!r} ({entry.where})"
    sizes = {key: size for key in entry.raw if (size := _size(key))}
    slopes = [key for key in entry.raw if key.split("_")[0] == "sensitivity"]
    others = {key: value for key, value in entry.raw.items() if key not in (*sizes, *slopes)}
    Table(others, where, (*OTHERS, *(f"{size}_nm" for size in SIZES), "sensitivity"))
    if len(sizes) != 1 or len(slopes) > 1:
        what = "one sensitivity at most" if len(sizes) == 1 else f"one of {', '.join(SIZES)} with its unit"
        raise InputError(f"A {where} must have {what}, such as half_width_nm; it has {len(sizes)} sizes.")
    ((key, (kind, suffix)),) = sizes.items()
    unit, factor = unit_of(suffix, where)
    entry = Table({**others, **{k: entry.raw[k] for k in slopes}, kind: entry.raw[key]}, where)
    slope, result, asked = _sensitivity(entry, slopes, unit, suffix)
    more: dict[str, Any] = {"sensitivity": slope}
    if "degrees_of_freedom" in entry:
        more["degrees_of_freedom"] = entry.number("degrees_of_freedom")
    return _made(entry, name, kind, factor, unit, more), result, asked


def _size(key: str) -> tuple[str, str] | None:
    """`half_width_nm` -> ("half_width", "nm"); `std` is a plain number; None for any other key."""
    for kind in SIZES:
        if key == kind or (key.startswith(f"{kind}_") and key not in SIZES):
            return kind, key[len(kind) + 1 :]
    return None


def _sensitivity(entry: Table, keys: Sequence[str], unit: str, suffix: str) -> tuple[float, str, str]:
    """Slope in SI per SI, SI unit of the result and its unit as asked for."""
    if not keys or keys[0] == "sensitivity":
        return entry.number("sensitivity", 1.0), unit, suffix
    key, where = keys[0], entry.where
    match = re.fullmatch(r"sensitivity_(\w+)_per_(\w+)", key)
    if not match:
        raise InputError(
            f"{key!r} of {where} must be 'sensitivity' or 'sensitivity_RESULT_per_INPUT', "
            "such as sensitivity_nm_per_urad."
        )
    (result, up), (given, down) = unit_of(match[1], where), unit_of(match[2], where)
    if given != unit:
        raise InputError(f"{key!r} of {where} must be per unit of the source ({unit}), not per {given}.")
    return entry.number(key) * up / down, result, match[1]


def _made(entry: Table, name: str, kind: str, factor: float, unit: str, more: dict[str, Any]) -> Source:
    """Return the source whose size stands under `kind`, `factor` times SI; `more`: what every kind takes."""
    allowed, share = SIZES[kind]
    asked = entry.choice("distribution", allowed, allowed[0])
    if (kind == "expanded") != ("coverage_factor" in entry):
        wrong = "needs its 'coverage_factor'" if kind == "expanded" else "takes no 'coverage_factor'"
        raise InputError(f"'{kind}' of {entry.where} {wrong}.")
    if kind == "readings":
        return Source.readings(name, [v * factor for v in entry.numbers(kind)], unit, **more)
    if asked == "student" and "degrees_of_freedom" not in more:
        raise InputError(f"Student's distribution of {entry.where} needs 'degrees_of_freedom'.")
    size = entry.number(kind, least=0.0) * factor * share / entry.positive("coverage_factor", 1.0)
    return Source(name, size / DIVISORS.get(asked, 1.0), unit, asked, **more)


def _correlation(file: Table, names: Sequence[str]) -> np.ndarray | None:
    entries = file.tables("correlation", ("between", "coefficient"))
    matrix = np.eye(len(names))
    for entry in entries:
        pair: Any = entry.raw.get("between")
        good = isinstance(pair, list) and len(pair) == 2 and pair[0] != pair[1]
        require(good, f"'between' of {entry.where}", "a list of two sources", pair)
        for name in pair:
            if name not in names:
                raise InputError(
                    f"{entry.where.capitalize()} names {name!r}, which is no source"
                    f"{nearest(str(name), list(names))}."
                )
        i, j = (names.index(name) for name in pair)
        matrix[i, j] = matrix[j, i] = entry.number("coefficient")
    return matrix if entries else None


def coverage_of(file: Table) -> tuple[float, float | None]:
    """Return the coverage factor, 2 by default, and the level of a file that may state one of them."""
    if "coverage_factor" in file and "level" in file:
        raise InputError(f"In {file.where} give 'coverage_factor' or 'level', not both.")
    return file.number("coverage_factor", 2.0), file.number("level") if "level" in file else None
