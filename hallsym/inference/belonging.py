"""Does a new log still belong to a calibration? Its residual error and each of its parameters are tested.

The log is refitted from the calibration. Its residual is compared with that of the calibration (F test), its
parameters with the calibrated ones, each (Student's t) and together (Hotelling's T squared). The limits share
one familywise false-alarm rate over all tests of a log (Sidak, J. Am. Stat. Assoc. 62 (1967) 626,
doi:10.1080/01621459.1967.10482935).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc, erfc, fdtrc, ndtri, stdtr

from hallsym.errors import require
from hallsym.estimation import Evaluation, Fit, fit
from hallsym.estimation.calibration import coverage_factor
from hallsym.estimation.factors import SINGULAR, pseudo_inverse, unit_scale
from hallsym.estimation.goodness_of_fit import GoodnessOfFit, ResidualNoise, noise_at
from hallsym.log import Noise, Sigma
from hallsym.shown import Shown

FALSE_ALARM = 1 / 500
"""Familywise false-alarm rate: one in 500 logs that belong."""
LEAST_FALSE_ALARM, MOST_FALSE_ALARM = 1e-6, 0.5
"""Range of that rate: below it, the tails of the distributions are not known well enough."""
SMALLEST = np.finfo(float).tiny
"""Least p-value, so that its score is a number."""
RESIDUAL, TOGETHER = "residual error", "parameters together"
"""Names of the tests that are not of one parameter."""


@dataclass(frozen=True)
class ParameterChange:
    """A parameter or combination in SI: values and standard uncertainties, `p_value` of no change.

    `significant`: corrected for the number of tests.
    """

    name: str
    unit: str
    before: float
    before_std: float
    after: float
    after_std: float
    p_value: float
    significant: bool


@dataclass(frozen=True)
class BelongingTest:
    """One quantity of a log against the calibration: a parameter, `RESIDUAL` or `TOGETHER`.

    `score`: distance from the calibration in standard deviations of a normal distribution of the same
    p-value, with the sign of the change: one scale for every test. `limit`: score beyond which the log does
    not belong.
    """

    name: str
    p_value: float
    score: float
    limit: float

    @property
    def two_sided(self) -> bool:
        """Whether a score below minus the limit counts too."""
        return self.name not in (RESIDUAL, TOGETHER)

    @property
    def distance(self) -> float:
        """Score over its limit: above 1 the quantity has changed."""
        return (abs(self.score) if self.two_sided else self.score) / self.limit

    @property
    def beyond(self) -> bool:
        """Whether the quantity has changed."""
        return self.distance > 1.0


@dataclass(frozen=True, repr=False)
class Belonging(Shown):
    """What `belonging` returns.

    `false_alarm`: familywise false-alarm rate over all tests. `refitted`: residual error after a fit of this
    log, in multiples of the noise of the calibration; `floor`: of the calibration itself. `tests`: one per
    quantity, `changes`: values behind the tests of parameters. `not_identified`: parameter -> why this log
    does not test it.
    """

    false_alarm: float
    refitted: float
    floor: float
    tests: tuple[BelongingTest, ...]
    changes: tuple[ParameterChange, ...]
    not_identified: dict[str, str]
    notes: tuple[str, ...]

    @property
    def beyond(self) -> tuple[BelongingTest, ...]:
        """The tests beyond their limits."""
        return tuple(test for test in self.tests if test.beyond)

    @property
    def belongs(self) -> bool:
        """Whether the log belongs to the calibration."""
        return not self.beyond

    @property
    def worst(self) -> BelongingTest:
        """The test that is nearest to its limit, or farthest beyond it."""
        return max(self.tests, key=lambda test: test.distance)

    @property
    def sentence(self) -> str:
        """Whether the log belongs, and what has changed where it does not."""
        if self.belongs:
            worst = self.worst
            return (
                f"The log belongs to the calibration: no change of the sensor shows in {len(self.tests)} "
                f"tests; the largest score is {worst.score:+.2f}, of {worst.name} (limit {worst.limit:.2f})."
            )
        return f"The log does not belong to the calibration: {'; '.join(map(self._said, self.beyond))}."

    def _said(self, test: BelongingTest) -> str:
        if test.name == RESIDUAL:
            return (
                f"residual error {self.refitted:.3g} x the noise after a fit of its own,"
                f" {self.floor:.3g} x at the calibration"
            )
        if test.name == TOGETHER:
            return "the parameters together have moved"
        change = next(c for c in self.changes if c.name == test.name)
        unit = "" if change.unit == "1" else f" {change.unit}"
        return f"{test.name} {change.before:.6g} -> {change.after:.6g}{unit}"

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym evaluate --json` prints of each log."""
        tests = [{**asdict(test), "beyond": test.beyond} for test in self.tests]
        return {**asdict(self), "tests": tests, "belongs": self.belongs, "sentence": self.sentence}


def check_false_alarm(chance: float) -> None:
    """Refuse a false-alarm rate out of range."""
    known = LEAST_FALSE_ALARM <= chance <= MOST_FALSE_ALARM
    limits = f"{LEAST_FALSE_ALARM:g} to {MOST_FALSE_ALARM:g}"
    require(known, "The probability of a false alarm", limits, chance)


def belonging(seen: Evaluation, *, false_alarm: float = FALSE_ALARM) -> Belonging:
    """Say whether a log that `evaluate` decoded still belongs to the calibration, and what changed if not.

    `false_alarm`: familywise false-alarm rate over all tests of the log. The noise of the calibration holds
    for the log, unless the log states its own.

    Raises `InputError` for a log that cannot be fitted.
    """
    check_false_alarm(false_alarm)
    known = seen.calibration
    stated = Noise({column: Sigma(s.value, "given") for column, s in known.noise.sigmas.items()})
    after = fit(
        replace(seen.decoded, noise=seen.decoded.noise.merged(stated)),
        known.model.with_parameters({n: {"nominal": known.value(n)} for n in known.model.names}),
        solver="direct",
        holdout=(),
        loss=known.solver.loss,
        start=known.values,
    )
    assert after.goodness is not None
    left = None  # too short for an estimate; assume the correlation of the calibration
    if after.likelihood is not None and after.source is not None:
        left = noise_at(after.source, after.likelihood.at(after.values), after.noise.std, after.keep)
    one, two = map(_estimates, (known, after))
    units = {p.name: p.unit for p in known.model.parameters}
    units |= {c.expression: c.unit for c in known.combinations}
    names = [name for name in one if name in two]
    single = [name for name in names if name in known.model.names]
    level = 1 - (1 - false_alarm) ** (1 / (len(names) + 1 + (len(single) > 1)))
    tests = [_residual(known, after, left, level)]
    if len(single) > 1:
        tests += _together(known, after, single, level)
    changes = []
    for name in names:
        (before, s, n), (now, t, m) = one[name], two[name]
        p = chance_of(now - before, (s, t), (n, m))
        changes.append(ParameterChange(name, units[name], before, s, now, t, p, p < level))
        tests.append(_test(name, p, level, np.sign(now - before), sides=2))
    floor = 1.0 if known.goodness is None else known.goodness.residual_over_noise
    return Belonging(
        false_alarm, after.goodness.residual_over_noise, floor, tuple(tests), tuple(changes),
        _not_identified(known, after), _notes(known, left),
    )  # fmt: skip


def _notes(known: Fit, left: ResidualNoise | None) -> tuple[str, ...]:
    """Return what weakens the comparison."""
    notes = []
    if known.goodness is None:
        notes.append(
            "The calibration is of an earlier version and does not state its residual; errors are compared"
            " against its noise alone."
        )
    if left is not None and not left.white and left.memory > 1:
        notes.append(
            f"Noise of neighbouring samples is correlated ({left.correlation:.2f}); the tests allow for it."
        )
    return tuple(notes)


def _estimates(found: Fit) -> dict[str, tuple[float, float, float]]:
    """Return value, standard uncertainty and degrees of freedom of what a fit determines, by name.

    Of parameters and combinations.
    """
    columns = zip(found.values.tolist(), found.std.tolist(), found.degrees_of_freedom.tolist(), strict=True)
    out = {
        name: (value, std, dof)
        for name, (value, std, dof), known in zip(found.model.names, columns, found.determined, strict=True)
        if known and name not in found.at_bound
    }
    return out | {c.expression: (c.value, c.std, c.dof) for c in found.combinations}


def _not_identified(known: Fit, after: Fit) -> dict[str, str]:
    """Return why some parameters are not compared."""
    left = {}
    for k, parameter in enumerate(known.model.parameters):
        name = parameter.name
        if parameter.width == 0 and name in known.fixed and name in after.fixed:
            continue
        if not known.determined[k]:
            left[name] = "the calibration does not determine it"
        elif name in after.at_bound or name in known.at_bound:
            left[name] = "it is at a bound"
        elif not after.determined[k]:
            left[name] = "this log does not identify it"
    return left


def _residual(known: Fit, after: Fit, left: ResidualNoise | None, level: float) -> BelongingTest:
    """Test whether the residual of the log exceeds that of the calibration: the ratio of two variances."""
    new, old = after.goodness, known.goodness
    assert new is not None
    dof = _independent(after, new, left)
    if old is None:
        return _test(RESIDUAL, float(chdtrc(dof, new.cost_per_degree_of_freedom * dof)), level)
    ratio = new.cost_per_degree_of_freedom / max(old.cost_per_degree_of_freedom, SMALLEST)
    return _test(RESIDUAL, float(fdtrc(dof, _independent(known, old, left), ratio)), level)


def chance_of(difference: float, stds: tuple[float, float], dofs: tuple[float, float]) -> float:
    """Return the p-value of no change between two independent estimates.

    The difference over its standard uncertainty follows Student's t with the degrees of freedom after Welch
    and Satterthwaite (Biometrics Bulletin 2 (1946) 110, doi:10.2307/3002019) where `dofs` are finite.
    """
    if not any(stds):
        return 1.0
    distance, dof = abs(difference) / np.hypot(*stds), welch(stds, dofs)
    return float(2 * stdtr(dof, -distance) if np.isfinite(dof) else erfc(distance / np.sqrt(2)))


def welch(stds: tuple[float, float], dofs: tuple[float, float]) -> float:
    """Return the degrees of freedom of the root of two summed variances."""
    share = sum(std**4 / dof for std, dof in zip(stds, dofs, strict=True))
    return float(np.hypot(*stds) ** 4 / share) if share > 0 else float("inf")


def _independent(found: Fit, goodness: GoodnessOfFit, left: ResidualNoise | None) -> float:
    """Return the degrees of freedom of a residual: from the scatter of runs, or of its noise if fewer.

    A few runs do not show the scatter of a mean square, which is larger for autocorrelated or heavy-tailed
    noise than for as many independent Gaussian readings.
    """
    fitted, K = 1 - len(found.log.holdout) / max(found.log.runs, 1), len(found.model.channels)
    inflation = 1.0
    if left is not None:
        error = 2 * np.log(left.interval[1] / left.ratio) / coverage_factor(np.inf)  # relative, of the square
        inflation = max(1.0, float(0.5 * error**2 * left.samples * K))
    return max(1.0, min(goodness.degrees_of_freedom, fitted * found.log.rows * K / inflation))


def _together(known: Fit, after: Fit, names: Sequence[str], level: float) -> list[BelongingTest]:
    """Test all parameters at once: a change along their correlation shows in none alone."""
    at = [known.model.names.index(name) for name in names]
    covariance = (known.covariance + after.covariance)[np.ix_(at, at)]
    moved, scale = (after.values - known.values)[at], unit_scale(covariance)
    distance = float(moved @ pseudo_inverse(covariance) @ moved)
    count = int(np.linalg.matrix_rank(covariance * np.outer(scale, scale), rtol=SINGULAR, hermitian=True))
    dof = min(
        welch((known.std[k], after.std[k]), (known.degrees_of_freedom[k], after.degrees_of_freedom[k]))
        for k in at
    )
    if not np.isfinite(dof):
        p = float(chdtrc(count, distance))
    elif dof > count:
        p = float(fdtrc(count, dof - count + 1, distance * (dof - count + 1) / (dof * count)))
    else:
        return []
    return [_test(TOGETHER, p, level)]


def _test(name: str, p: float, level: float, sign: float = 1.0, sides: int = 1) -> BelongingTest:
    """Return a test on the scale of a normal distribution; `sides`: of the distribution that count."""
    score = float(-ndtri(np.clip(p / sides, SMALLEST, np.nextafter(1, 0)))) * float(sign or 1.0)
    return BelongingTest(name, p, score, float(-ndtri(level / sides)))
