"""Which tolerance to tighten: global sensitivity of the nominal decoder's errors, before any data.

First index S_j = V(E(y | p_j)) / V(y): the share of the variance removed if p_j is known. Total index
T_j = E(V(y | all but p_j)) / V(y): the share that remains if all others are known. Estimators: Saltelli
et al., Comput. Phys. Commun. 181 (2010) 259, doi:10.1016/j.cpc.2009.09.018, Table 2 (b) and (f). For a field
of errors y(t), numerators and denominator are averaged over t before the division (Gamboa et al., Electron.
J. Stat. 8 (2014) 575, doi:10.1214/14-EJS895), so that large errors have their weight.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hallsym.errors import InputError, require
from hallsym.model import Model
from hallsym.records import named
from hallsym.shown import Shown
from hallsym.simulation import Campaign, Run, paper_campaign
from hallsym.uncertainty.along import Errors, decoding_errors
from hallsym.uncertainty.ranges import USUAL, Tolerance, default_tolerances, given_tolerances

BLOCK = 2**16
"""Machines times points that are evaluated at once; bounds the memory."""
LEAST_SAMPLES, MOST_SAMPLES = 16, 2**16
"""Base samples."""
ENOUGH = 0.05
"""Half width of a 95 % interval below which an index is called sharp."""
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
        """Largest half width of a 95 % interval of an index of the error."""
        return max(indices.widest for indices in self.indices.values())

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
            "sharp": self.widest <= ENOUGH,
            "notes": list(self.notes),
        }  # fmt: skip


# -- the study -------------------------------------------------------------------------------------------


def tolerances(
    model: Model,
    where: Campaign | Workspace | None = None,
    *,
    ranges: Mapping[str, Any] | tuple[Tolerance, ...] | None = None,
    samples: int = 1024,
    seed: int = 0,
) -> Tolerances:
    """Return the sensitivity of the nominal decoder's errors to each tolerance of the machine.

    Machines are drawn with every parameter independent in its tolerance; each is read by a decoder that uses
    the nominal values, without calibration, noise or zero deviations. `where`: campaign or
    workspace over which errors count (default: the paper's campaign). `ranges`: see `given_tolerances`;
    default: nominal value +- half the width of the model's bounds. `samples`: base samples of Saltelli's
    design, a power of two; 2 n + 2 times as many machines are drawn for n tolerances. The same seed gives the
    same numbers.

    Raises `InputError` for an unknown parameter or unit and a tolerance that is not positive.
    """
    good = LEAST_SAMPLES <= samples <= MOST_SAMPLES and not samples & (samples - 1)
    near = 2 ** round(np.log2(min(max(samples, LEAST_SAMPLES), MOST_SAMPLES)))
    wanted = f"a power of two from {LEAST_SAMPLES} to {MOST_SAMPLES}, such as {near}"
    require(good, "'samples'", wanted, samples)
    require(seed >= 0, "A seed", "a whole number, 0 or more", seed)
    where = paper_campaign() if where is None else where
    space = workspace_of(model, where) if isinstance(where, Campaign) else where
    all_ = _ranges(model, ranges)
    active = tuple(t for t in all_ if t.width > 0)
    if not active:
        raise InputError(f"Every parameter of {model.name} is exact: there is no tolerance to judge.")
    draws = design(len(active), samples, seed)
    machines = partial(_machines, all_, active)
    errors_of = decoding_errors(
        model, model, space.pose, space.state, "state narrower tolerances in --ranges"
    )
    fields, errors, squares = _drawn(errors_of, draws, machines)
    return Tolerances(
        model=model,
        tolerances=all_,
        active=tuple(t.name for t in active),
        points=space.points,
        samples=samples,
        seed=seed,
        errors=errors,
        indices={c: field_indices(m, seed) for c, m in zip(model.pose, fields, strict=True)},
        worth=_worth(errors_of, squares, draws[:, 0], all_, active, space.points),
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


def _machines(all_: tuple[Tolerance, ...], active: tuple[Tolerance, ...], u: np.ndarray) -> np.ndarray:
    """Parameters (m, n) of machines at probabilities u (m, n_active); exact ones at their centre."""
    out = np.tile(np.array([t.centre for t in all_]), (len(u), 1))
    place = {t.name: k for k, t in enumerate(all_)}
    for j, t in enumerate(active):
        out[:, place[t.name]] = t.at(u[:, j])
    return out


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


def _blocks(samples: int, rows: int) -> Iterator[slice]:
    """Samples of so many rows each, machines times points, in blocks of bounded size."""
    step = max(1, BLOCK // rows)
    return (slice(k, min(k + step, samples)) for k in range(0, samples, step))


def _drawn(errors: Errors, draws: np.ndarray, machines: Any) -> tuple[list[Moments], Errors95, np.ndarray]:
    """Return moments of each coordinate's field over the whole design, and errors of machines A and B.

    The mean field comes first, so that moments are centred. Last, the mean square over the workspace of each
    machine A, (n_pose, samples).
    """
    samples, rows, n = draws.shape
    points = errors(machines(draws[0, :1])).shape[2]
    totals = [
        errors(machines(draws[at][:, [0, -1]].reshape(-1, n))).sum(axis=1)
        for at in _blocks(samples, 2 * points)
    ]
    mean = sum(totals) / (2 * samples)
    squares, peaks = [], []
    parts: list[list[Moments]] = [[] for _ in mean]
    for at in _blocks(samples, rows * points):
        field = errors(machines(draws[at].reshape(-1, n))).reshape(len(mean), -1, rows, points)
        plain = field[:, :, [0, -1]]
        squares.append(np.einsum("csjt,csjt->csj", plain, plain) / points)
        peaks.append(np.abs(plain).max(axis=-1))
        for part, y, centre in zip(parts, field, mean, strict=True):
            part.append(moments(y, centre))
    fields = []
    for part in parts:
        first, total, variance = (np.concatenate(column) for column in zip(*part, strict=True))
        fields.append((first, total, variance))
    square, peak = np.hstack(squares), np.hstack(peaks)
    found = Errors95(
        rms=np.sqrt(square.mean(axis=(1, 2))),
        mean=np.sqrt((mean**2).mean(axis=1)),
        rms_95=np.sqrt(np.quantile(square, 0.95, axis=(1, 2))),
        peak_95=np.quantile(peak, 0.95, axis=(1, 2)),
    )
    return fields, found, square[..., 0]


def _worth(
    errors: Errors, before: np.ndarray, u: np.ndarray, all_: tuple[Tolerance, ...],
    active: tuple[Tolerance, ...], points: int,
) -> Worth:  # fmt: skip
    """Draw the machines A again, one tolerance exact at a time, everything else the same.

    `before`: their mean squares as they were, (n_pose, samples).
    """
    rows = []
    for t in active:
        exact = replace(t, centre=t.nominal, width=0.0)
        ranges, moved = (tuple(exact if k.name == t.name else k for k in some) for some in (all_, active))
        drawn = _machines(ranges, moved, u)
        after = [np.square(errors(drawn[at])).mean(axis=2) for at in _blocks(len(u), points)]
        rows.append(_falls(before, np.hstack(after)))
    return Worth(*np.array(rows).transpose(1, 0, 2))


def _falls(before: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Relative decrease and its half width (2, n_pose) as in `Worth`; 0 without an error."""
    level = before.mean(axis=1)
    safe = np.where(level > 0, level, 1.0)
    ratio = np.where(level > 0, exact.mean(axis=1) / safe, 1.0)
    scatter = (exact - ratio[:, None] * before).std(axis=1, ddof=1) / np.sqrt(before.shape[1]) / safe
    width = np.where(ratio > 0, COVERAGE * scatter / (2 * np.sqrt(np.where(ratio > 0, ratio, 1.0))), 0.0)
    return np.array([1 - np.sqrt(ratio), width])


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
