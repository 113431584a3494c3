"""Which tolerance to tighten: global sensitivity of the nominal decoder's errors, before any data.

First index S_j = V(E(y | p_j)) / V(y): the share of the variance removed if p_j is known. Total index
T_j = E(V(y | all but p_j)) / V(y): the share that remains if all others are known. Estimators: Saltelli
et al., Comput. Phys. Commun. 181 (2010) 259, doi:10.1016/j.cpc.2009.09.018, Table 2 (b) and (f). For a field
of errors y(t), numerators and denominator are averaged over t before the division (Gamboa et al., Electron.
J. Stat. 8 (2014) 575, doi:10.1214/14-EJS895), so that large errors have their weight.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hallsym.errors import InputError, require
from hallsym.model import Model
from hallsym.records import named
from hallsym.shown import Shown
from hallsym.simulation import Campaign, Run, default_campaign
from hallsym.uncertainty.along import Errors, decoding_errors
from hallsym.uncertainty.ranges import USUAL, Tolerance, default_tolerances, given_tolerances

BLOCK = 2**16
"""Machines times points that are evaluated at once; bounds the memory."""
LEAST_SAMPLES, MOST_SAMPLES = 16, 2**16
USUAL_SAMPLES = 1024
"""Base samples: fewest, most, and most unless more are asked for."""
ENOUGH = 0.05
"""Half width of a 95 % interval below which it is called sharp."""
MANY = 2**14
"""Machines, at least, of which the quantiles of the linear part are known: to 1 %."""
COVERAGE, RESAMPLES = 1.96, 200
"""Standard deviations of a 95 % interval, and bootstrap resamples that it is from."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Points of equal weight: `pose` (n_pose, points) and `state` (n_state, points), in SI."""

    pose: np.ndarray
    state: np.ndarray

    @property
    def points(self) -> int:
        """Number of points."""
        return self.pose.shape[1]


def workspace_of(model: Model, campaign: Campaign, points_per_run: int = 8) -> Workspace:
    """Return a campaign's poses and states, at most `points_per_run` samples of each run, evenly spaced.

    Eight samples of a sine's period hold its peaks and the exact mean of any product of up to seven sines.
    """
    times = [_times(campaign, run, points_per_run) for run in campaign.runs]
    if not times:
        raise InputError("The campaign must have at least one run to span a workspace; it has none.")

    def along(columns: Sequence[str]) -> np.ndarray:
        rows = [
            np.concatenate([run.position(c, t) for run, t in zip(campaign.runs, times, strict=True)])
            for c in columns
        ]
        return np.array(rows).reshape(len(columns), sum(map(len, times)))

    return Workspace(along(model.pose), along(model.state))


def _times(campaign: Campaign, run: Run, points: int) -> np.ndarray:
    total = campaign.samples(run)
    return np.arange(min(points, total)) * total // min(points, total) * campaign.step_s


# -- what is found ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Indices:
    """First and total indices of one output, (n,) each, with half widths of their 95 % intervals."""

    first: np.ndarray
    total: np.ndarray
    first_half: np.ndarray
    total_half: np.ndarray

    @property
    def widest(self) -> float:
        """Largest half width of an interval."""
        return float(max(self.first_half.max(initial=0.0), self.total_half.max(initial=0.0)))


@dataclass(frozen=True, eq=False)
class Errors95:
    """Errors of the machines drawn, per pose coordinate: rms over machines and workspace, and quantiles."""

    rms: np.ndarray
    mean: np.ndarray
    rms_95: np.ndarray
    peak_95: np.ndarray


@dataclass(frozen=True, eq=False)
class Worth:
    """Relative decrease of the rms over machines and workspace if one tolerance is exact.

    `exact_half`: half width of the 95 % interval of `exact`, both (n, n_pose). Negative where it grows. From
    machines drawn again with that tolerance alone changed.
    """

    exact: np.ndarray
    exact_half: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class Tolerances(Shown):
    """Result of `tolerances`. Arrays have one row per entry of `active`, the tolerances that are not exact.

    `indices`: pose column -> Sobol indices of the error, averaged over the workspace.
    """

    model: Model
    tolerances: tuple[Tolerance, ...]
    active: tuple[str, ...]
    points: int
    samples: int
    seed: int
    errors: Errors95
    indices: Mapping[str, Indices]
    worth: Worth
    notes: tuple[str, ...]

    @property
    def ranking(self) -> tuple[str, ...]:
        """Active tolerances by the mean square error of all outputs that they cause, largest first."""
        value = 1 - (1 - self.worth.exact) ** 2  # fall of the mean square
        return tuple(self.active[j] for j in np.argsort(-value.mean(axis=1), kind="stable"))

    @property
    def widest(self) -> float:
        """Largest half width of a 95 % interval of an index of the error or of a worth."""
        indices = (indices.widest for indices in self.indices.values())
        return max(*indices, float(self.worth.exact_half.max()))

    @property
    def wanted(self) -> int:
        """Base samples, about, of which all intervals are sharp: half the width takes four times as many."""
        return self.samples * 2 ** max(0, int(np.ceil(2 * np.log2(self.widest / ENOUGH))))

    @property
    def sharp(self) -> bool:
        """Whether all intervals are narrow enough to rank by."""
        return self.widest <= ENOUGH

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, SI."""
        by_pose = partial(named, self.model.pose)
        return {
            "model": self.model.name,
            "seed": self.seed,
            "samples": self.samples,
            "points": self.points,
            "tolerances": {
                t.name: {
                    "unit": t.unit, "designed": float(t.nominal), "centre": float(t.centre),
                    "width": float(t.width), "distribution": t.distribution, "std": float(t.std),
                    "source": t.source,
                }
                for t in self.tolerances
            },
            "errors": {name: by_pose(values) for name, values in vars(self.errors).items()},
            "ranking": list(self.ranking),
            "worth": {
                name: {what: by_pose(values[j]) for what, values in vars(self.worth).items()}
                for j, name in enumerate(self.active)
            },
            "indices": {
                c: {
                    name: {what: float(values[j]) for what, values in vars(i).items()}
                    for j, name in enumerate(self.active)
                }
                for c, i in self.indices.items()
            },
            "sharp": self.sharp,
            "notes": list(self.notes),
        }  # fmt: skip


# -- the study -------------------------------------------------------------------------------------------


def tolerances(
    model: Model,
    where: Campaign | Workspace | None = None,
    *,
    ranges: Mapping[str, Any] | tuple[Tolerance, ...] | None = None,
    samples: int | None = None,
    seed: int = 0,
) -> Tolerances:
    """Return the sensitivity of the nominal decoder's errors to each tolerance of the machine.

    Machines are drawn with every parameter independent in its tolerance; each is read by a decoder that uses
    the nominal values, without calibration, noise or zero deviations. `where`: campaign or workspace over
    which errors count (default: the example of the model's family, else the paper's campaign).
    `ranges`: see `given_tolerances`; default: nominal value +- half the width of the model's bounds.
    `samples`: base samples of Saltelli's design, a power of two; 2 n + 2 times as many machines are drawn for
    n tolerances. None: as many as make every interval sharp, at most `USUAL_SAMPLES`. The same seed gives the
    same numbers.

    Raises `InputError` for an unknown parameter or unit and a tolerance that is not positive.
    """
    if samples is None:
        study = partial(tolerances, model, where, ranges=ranges, seed=seed)
        pilot = study(samples=LEAST_SAMPLES)
        return pilot if pilot.sharp else study(samples=min(pilot.wanted, USUAL_SAMPLES))
    good = LEAST_SAMPLES <= samples <= MOST_SAMPLES and not samples & (samples - 1)
    near = 2 ** round(np.log2(min(max(samples, LEAST_SAMPLES), MOST_SAMPLES)))
    wanted = f"a power of two from {LEAST_SAMPLES} to {MOST_SAMPLES}, such as {near}"
    require(good, "'samples'", wanted, samples)
    require(seed >= 0, "A seed", "a whole number, 0 or more", seed)
    where = default_campaign(model) if where is None else where
    space = workspace_of(model, where) if isinstance(where, Campaign) else where
    all_ = _ranges(model, ranges)
    active = [k for k, t in enumerate(all_) if t.width > 0]
    if not active:
        raise InputError(f"Every parameter of {model.name} is exact: there is no tolerance to judge.")
    drawn = tuple(all_[k] for k in active)
    centre, scale = (np.array([getattr(t, name) for t in all_]) for name in ("centre", "std"))
    decoded = decoding_errors(model, model, space.pose, space.state, "state narrower tolerances in --ranges")

    def errors(z: np.ndarray) -> np.ndarray:
        machines = np.tile(centre, (len(z), 1))
        machines[:, active] += scale[active] * z
        return decoded(machines)

    return Tolerances(
        model=model,
        tolerances=all_,
        active=tuple(t.name for t in drawn),
        points=space.points,
        samples=samples,
        seed=seed,
        **_drawn(errors, drawn, model.pose, samples, seed),
        notes=tuple(_notes(model, all_)),
    )


def _ranges(model: Model, ranges: Mapping[str, Any] | tuple[Tolerance, ...] | None) -> tuple[Tolerance, ...]:
    if ranges is None:
        return default_tolerances(model)
    if isinstance(ranges, Mapping):
        return given_tolerances(model, ranges)
    if tuple(t.name for t in ranges) != model.names:
        raise InputError(f"'ranges' must hold one Tolerance per parameter of {model.name}, in its order.")
    return ranges


def design(n: int, samples: int, seed: int) -> np.ndarray:
    """Return Saltelli's design on the unit cube, shape (samples, n + 2, n): A, A with column j of B, B.

    Scrambled Sobol points; `samples` must be a power of two, which keeps them balanced.
    """
    from scipy.stats.qmc import Sobol

    points = Sobol(2 * n, scramble=True, seed=seed).random(samples)
    out = np.repeat(points[:, None, :n], n + 2, axis=1)
    for j in range(n):
        out[:, j + 1, j] = points[:, n + j]
    out[:, -1] = points[:, n:]
    return out


# -- machines drawn, block by block ----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Linear:
    """The part of the errors that is linear in the tolerances: a control variate, whose means are known.

    A mean over machines is that of the error less that of this part, plus the known mean of this part: drawn
    machines only have to show what is not linear. Owen, Monte Carlo theory, methods and examples, 8.9
    (artowen.su.domains/mc). `start`: errors (n_pose, points) at the centres of all ranges. `slope`: change by
    one standard deviation of each tolerance, (n_pose, n, points).
    """

    start: np.ndarray
    slope: np.ndarray

    @classmethod
    def of(cls, errors: Errors, n: int) -> "Linear":
        """Return that of `errors(z)` of machines at z (m, n) standard deviations from the centres.

        Slopes are by Gauss's quadrature of two points along each tolerance.
        """
        e = errors(np.vstack([np.zeros((1, n)), np.eye(n), -np.eye(n)]))
        return cls(e[:, 0], (e[:, 1 : n + 1] - e[:, n + 1 :]) / 2)

    def fitted(self, z: np.ndarray, errors: np.ndarray) -> "Linear":
        """Return the mean of `errors` (n_pose, m, points) of machines, and the slopes times a factor.

        The factor, one of each coordinate, leaves least scatter: 1 where errors are linear, near 0 where they
        go round a circle.
        """
        change = z @ self.slope
        norm = np.einsum("cmt,cmt->c", change, change)
        factor = np.einsum("cmt,cmt->c", change, errors - self.start[:, None]) / np.where(norm > 0, norm, 1)
        change, slope = (factor[:, None, None] * v for v in (change, self.slope))
        return Linear((errors - change).mean(axis=1), slope)

    def errors(self, z: np.ndarray) -> np.ndarray:
        """Return this part of the errors of machines, (n_pose, m, points)."""
        return np.asarray(self.start[:, None] + z @ self.slope)

    def squares(self, exact: np.ndarray) -> np.ndarray:
        """Return the expectation of `squares` of this part, (n_pose, 3 n + 3).

        `exact` (n,): where each tolerance is exact, in standard deviations from its centre.
        """
        shares = (self.slope**2).mean(axis=2)
        variance = shares.sum(axis=1, keepdims=True)
        level = (self.start**2).mean(axis=1, keepdims=True) + variance
        moved = ((self.start[:, None] + exact[:, None] * self.slope) ** 2).mean(axis=2)
        return np.hstack([shares, shares, variance, level, level, moved + variance - shares])


Moments = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Means over the field for each base sample: numerators of first and total indices, (samples, n) each, and
the variance, (samples,)."""


def moments(y: np.ndarray, mean: np.ndarray) -> Moments:
    """Return the moments of a field, `y` (samples, n + 2, points), about its mean (points,)."""
    A, AB, B = y[:, 0] - mean, y[:, 1:-1] - mean, y[:, -1] - mean
    change = AB - A[:, None]
    first = np.einsum("st,sjt->sj", B, change)  # 2010, Table 2 (b)
    total = np.einsum("sjt,sjt->sj", change, change) / 2  # 2010, Table 2 (f)
    variance = (np.einsum("st,st->s", A, A) + np.einsum("st,st->s", B, B)) / 2
    return first / y.shape[2], total / y.shape[2], variance / y.shape[2]


def field_indices(m: Moments, seed: int) -> Indices:
    """Return the indices of a field; intervals by the bootstrap over base samples."""
    first, total, variances = m
    samples, n = first.shape
    variance = variances.mean()
    if not variance > 0:
        return Indices(*np.zeros((4, n)))
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(samples, np.full(samples, 1 / samples), RESAMPLES) / samples
    again = (counts @ variances)[:, None]
    halves = [COVERAGE * ((counts @ part) / again).std(axis=0, ddof=1) for part in (first, total)]
    return Indices(first.mean(axis=0) / variance, total.mean(axis=0) / variance, *halves)


def squares(field: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Return what is quadratic in the errors of machines A, A with a column of B, B, A with one exact.

    `field` (n_pose, samples, 2 n + 2, points) -> (n_pose, samples, 3 n + 3): `moments` about `mean`
    (n_pose, points), then the mean squares over the workspace of A, B and each A with one exact.
    """
    n, out = field.shape[2] // 2 - 1, []
    for y, centre in zip(field, mean, strict=True):
        first, total, variance = moments(y[:, : n + 2], centre)
        square = (np.delete(y, np.s_[1 : n + 1], axis=1) ** 2).mean(axis=2)
        out.append(np.hstack([first, total, variance[:, None], square]))
    return np.array(out)


def _sizes(e: np.ndarray) -> np.ndarray:
    """Return rms and peak of each machine, (2, n_pose, m), of errors (n_pose, m, points)."""
    return np.array([np.sqrt((e**2).mean(axis=2)), np.abs(e).max(axis=2)])


def _drawn(
    errors: Errors, drawn: tuple[Tolerance, ...], pose: Sequence[str], samples: int, seed: int
) -> dict[str, Any]:
    """Return `errors`, `indices` and `worth` of `Tolerances` from `errors` of machines, as in `Linear`."""
    n = len(drawn)
    exact = np.array([(t.nominal - t.centre) / t.std for t in drawn])

    def deviations(u: np.ndarray) -> np.ndarray:
        return np.stack([(t.at(u[..., j]) - t.centre) / t.std for j, t in enumerate(drawn)], axis=-1)

    draws, one = design(n, samples, seed), np.eye(n, dtype=bool)
    some = deviations(draws[:LEAST_SAMPLES, [0, -1]].reshape(-1, n))
    linear = Linear.of(errors, n).fitted(some, errors(some))
    mean, known, rest = linear.start, linear.squares(exact)[:, None], np.zeros_like(linear.start)
    points, found, sizes = mean.shape[1], [], []
    for z in map(deviations, _blocks(draws, 2 * points)):
        z = np.hstack([z, np.where(one, exact, z[:, :1])])
        shape = (len(mean), *z.shape[:2], -1)
        y, part = (f(z.reshape(-1, n)).reshape(shape) for f in (errors, linear.errors))
        found.append(squares(y, mean) - squares(part, mean) + known)
        plain, of_part = (e[:, :, [0, n + 1]].reshape(len(mean), -1, points) for e in (y, part))
        rest += (plain - of_part).sum(axis=1) / (2 * samples)
        sizes.append([_sizes(plain), _sizes(of_part)])
    first, total, variance, square = np.split(np.hstack(found), [n, 2 * n, 2 * n + 1], axis=2)
    variance = variance[..., 0] - np.mean(rest**2, axis=1)[:, None]
    many = np.random.default_rng(seed).random((max(MANY, 4 * samples), n))
    of_many = [_sizes(linear.errors(z)) for z in map(deviations, _blocks(many, points))]
    ours, of_ours, of_all = (
        np.quantile(v, 0.95, axis=-1)
        for v in (*np.concatenate(sizes, axis=-1), np.concatenate(of_many, axis=-1))
    )
    worth = [_falls(square[:, :, 0], square[:, :, 2 + j]) for j in range(n)]
    return {
        "errors": Errors95(
            np.sqrt(np.maximum(square[:, :, :2].mean(axis=(1, 2)), 0.0)),
            np.sqrt(((mean + rest) ** 2).mean(axis=1)),
            *(ours - of_ours + of_all),
        ),
        "indices": {
            c: field_indices(m, seed)
            for c, m in zip(pose, zip(first, total, variance, strict=True), strict=True)
        },
        "worth": Worth(*np.array(worth).transpose(1, 0, 2)),
    }


def _blocks(draws: np.ndarray, points: int) -> Iterator[np.ndarray]:
    """Parts of bounded size of draws (samples, ..., n) of machines, each at so many points."""
    step = max(1, BLOCK * draws.shape[-1] // (draws[0].size * points))
    return (draws[k : k + step] for k in range(0, len(draws), step))


def _falls(before: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Relative decrease and its half width (2, n_pose) as in `Worth`; 0 without an error."""
    level = before.mean(axis=1)
    safe = np.where(level > 0, level, 1.0)
    ratio = np.where(level > 0, exact.mean(axis=1) / safe, 1.0)
    scatter = (exact - ratio[:, None] * before).std(axis=1, ddof=1) / np.sqrt(before.shape[1]) / safe
    width = np.where(ratio > 0, COVERAGE * scatter / (2 * np.sqrt(np.where(ratio > 0, ratio, 1.0))), 0.0)
    return np.array([1 - np.sqrt(np.maximum(ratio, 0.0)), width])


def _notes(model: Model, all_: tuple[Tolerance, ...]) -> Iterator[str]:
    bounds = [t.name for t in all_ if t.source == "bounds" and t.width > 0]
    if bounds:
        yield (
            f"the ranges of {len(bounds)} parameters are half the width of the model's bounds about the "
            "nominal value: search ranges of a calibration, not drawing tolerances."
        )
    usual = [t.name for t in all_ if t.source == USUAL and t.width > 0]
    if usual:
        yield (
            f"the ranges of {len(usual)} parameters are usual tolerances of such machines, not yours: state "
            "yours in a tolerance file."
        )
    if model.offsets:
        yield "zero deviations are new at every reset, not a tolerance of the machine: they are left out."
