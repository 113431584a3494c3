"""Decode the pose from readings over a log and tabulate its errors against the reference."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.log import Block, Log
from hallsym.log.batches import Batch, Weigh, batches
from hallsym.log.derived import extended
from hallsym.log.phase import wrapped
from hallsym.model import Model
from hallsym.model.arrays import estimator, jacobian, on_arrays


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """Errors of the decoded pose, run by run: reference subtracted, one column per pose coordinate.

    `count`: (runs,) samples. `squares`: (runs, n_pose) sums of squares. `peak`: (runs, n_pose) largest
    absolute error. Units are those of `pose` (m, rad). `span`: least and greatest value by column of
    reference and state, over the samples that took part.
    """

    pose: tuple[str, ...]
    runs: tuple[int, ...]
    count: np.ndarray
    squares: np.ndarray
    peak: np.ndarray
    span: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def over(self, runs: Sequence[int] | None = None) -> dict[str, dict[str, float]] | None:
        """Return `{"rmse": {x_m: ..}, "peak": {..}}` over some runs (default: all); None without any."""
        among = set(self.runs if runs is None else runs)
        pick = [k for k, run in enumerate(self.runs) if run in among]
        if not pick or self.count[pick].sum() == 0:
            return None
        rmse = np.sqrt(self.squares[pick].sum(axis=0) / self.count[pick].sum())
        peak = self.peak[pick].max(axis=0)
        return {
            "rmse": dict(zip(self.pose, rmse.tolist(), strict=True)),
            "peak": dict(zip(self.pose, peak.tolist(), strict=True)),
        }


@dataclass(frozen=True, eq=False)
class Errors(Mapping[str, "dict[str, dict[str, float]] | None"]):
    """Error tables of the decoded pose, and rmse and peak of each row as `ErrorTable.over` gives them.

    The row "designed" is of nominal parameters without zero deviations, over all runs; "fitted" and "holdout"
    are of the fit, over theirs. `nominal()` returns the table of the first, which is made when it is asked.
    """

    fitted: ErrorTable
    holdout: tuple[int, ...]
    nominal: Callable[[], ErrorTable]

    @cached_property
    def designed(self) -> ErrorTable:
        """Errors of nominal parameters without zero deviations."""
        return self.nominal()

    def rows(self) -> dict[str, dict[str, dict[str, float]] | None]:
        """Return every row."""
        return dict(self)

    def __getitem__(self, row: str) -> dict[str, dict[str, float]] | None:
        """Return one row; None of one without a run."""
        if row == "designed":
            return self.designed.over()
        judging = {"fitted": False, "holdout": True}[row]
        return self.fitted.over([run for run in self.fitted.runs if (run in self.holdout) == judging])

    def __iter__(self) -> Iterator[str]:
        """Yield the names of the rows."""
        return iter(("designed", "fitted", "holdout"))

    def __len__(self) -> int:
        """Return the number of rows."""
        return 3


def nominal_variance(model: Model, reading_variance: np.ndarray) -> np.ndarray:
    """Return the variance of each reading (K,) by which nominal parameters decode: equal for readings of one
    unit, since a nominal decoder assumes no noise; else the known ones."""
    units = {channel.rpartition("_")[2] for channel in model.channels}
    return np.ones(len(model.channels)) if len(units) == 1 else np.asarray(reading_variance)


def column_slopes(
    model: Model, p: np.ndarray, pose: Sequence | np.ndarray, state: Sequence | np.ndarray
) -> np.ndarray:
    """Return d reading / d column of pose and state at offsets of 0, (s, n_channels, columns)."""

    def made() -> Callable[..., list[np.ndarray]]:
        s = model.symbols
        reading = ca.substitute(s.full(s.reading), s.offsets, ca.SX.zeros(s.offsets.numel()))
        slope = jacobian(reading, ca.vertcat(s.pose, s.state))
        return on_arrays(ca.Function("slope", [s.parameters, s.pose, s.state], [ca.densify(slope)]))

    (flat,) = model.remember("slopes by column", made)(p, pose, state)
    return np.transpose(flat.reshape(-1, len(model.channels), np.size(pose[0])), (2, 1, 0))


def gain_at(
    model: Model, p: np.ndarray, pose: Sequence | np.ndarray, state: Sequence | np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Return d pose / d reading at any pose, (s, n_pose, n_channels).

    Solved in numbers: written out, the solution of six equations is most of the graph.
    """
    return estimator(column_slopes(model, p, pose, state)[:, :, : len(model.pose)], weight)


def decoding_gain(
    model: Model, p: np.ndarray, pose: Sequence[np.ndarray], state: Sequence[np.ndarray], weight: np.ndarray
) -> np.ndarray:
    """Return d pose / d reading at some samples, (n_pose, K, samples); `weight`: 1/variance of each channel.

    A chip that gives the pose itself has 1: where its channels clip it loses the pose, not its unit. Readings
    that are nearly linear in the pose have that of the zero pose: at a rail their own slope is nil.
    """
    shape = len(model.pose), len(model.channels), np.size(pose[0])
    if len(model.channels) == 1:
        return np.ones(shape)
    if model.typical:
        return gain_at(model, p, pose, state, weight).transpose(1, 2, 0)
    still = model.remember("gain at rest, on arrays", lambda: on_arrays(model.noise_gain))
    flat = still(p, state, weight)[0].reshape(shape[1], shape[0], -1)
    return np.broadcast_to(flat.swapaxes(0, 1), shape)


def knows_rails(model: Model) -> bool:
    """Return whether a model includes the rails of its readings."""
    return "saturation" in model.effects


Version = tuple[np.ndarray, Mapping[int, np.ndarray]]
"""Parameters (n,), and offsets by run."""
PoseErrors = Callable[[np.ndarray, np.ndarray, Mapping[str, np.ndarray]], np.ndarray]


def pose_errors(model: Model, reading_variance: np.ndarray) -> PoseErrors:
    """Return `errors(p, offsets, data) -> (n_pose, samples)`: decoded pose minus reference.

    A reading at its rail has lost its pose: with `saturation` the errors are those of the readings, mapped to
    the pose to first order.
    """
    weight = 1.0 / np.asarray(reading_variance)
    if not knows_rails(model):

        def decoded(p: np.ndarray, offsets: np.ndarray, data: Mapping[str, np.ndarray]) -> np.ndarray:
            readings, states = ([data[c] for c in names] for names in (model.channels, model.state))
            reference = [data[c] for c in model.references]
            found = model.decode(p, offsets, readings, states, weight, reference)
            for row, column in zip(found, reference, strict=True):
                row -= column
            return found

        return decoded
    read = on_arrays(model.reading)

    def mapped(p: np.ndarray, offsets: np.ndarray, data: Mapping[str, np.ndarray]) -> np.ndarray:
        pose, states = ([data[c] for c in names] for names in (model.references, model.state))
        residual = np.array([data[c] for c in model.channels]) - read(p, offsets, pose, states)[0]
        return np.einsum("iks,ks->is", decoding_gain(model, p, pose, states, weight), residual)

    return mapped


def residual_of(model: Model) -> Callable[[np.ndarray, np.ndarray, Mapping[str, np.ndarray]], np.ndarray]:
    """Return `(p, offsets, data) -> (n_channels, samples)`: reading minus the model's at the reference, SI.

    `offsets`: (z,), or (z, samples).
    """
    read = on_arrays(model.reading)
    periods = [(k, model.period[c]) for k, c in enumerate(model.channels) if c in model.period]

    def residual(p: np.ndarray, offsets: np.ndarray, data: Mapping[str, np.ndarray]) -> np.ndarray:
        pose, state = ([data[c] for c in names] for names in (model.references, model.state))
        left = read(p, offsets, pose, state)[0]
        for row, channel in zip(left, model.channels, strict=True):
            np.subtract(data[channel], row, out=row)
        for k, period in periods:
            left[k] = wrapped(left[k], period)
        return left

    return residual


def residuals(
    model: Model, p: np.ndarray, offsets: Mapping[int, np.ndarray]
) -> Callable[[Block], np.ndarray]:
    """Return `block -> (n_channels, samples)`: the same of a run with its offsets."""
    residual, none = residual_of(model), np.zeros(len(model.offsets))
    return lambda block: residual(p, offsets.get(block.run, none), block.data)


def check_decoded(errors: np.ndarray, model: Model, log: Log, run: int) -> None:
    """Raise `InputError` where decoded errors (n_pose, samples) of a run are not finite."""
    lost = np.count_nonzero(~np.isfinite(errors).all(axis=0))
    if lost:
        raise InputError(
            f"{lost} of {errors.shape[1]} samples of run {run} of {log.name} give no pose with the "
            f"parameters of {model.name}: a channel is scaled, exchanged or dead, or an effect takes its "
            "signal away."
        )


def error_tables(
    log: Log,
    model: Model,
    versions: Sequence[Version],
    reading_variance: np.ndarray,
    keep: Weigh | None = None,
    on_rows: Callable[[int], None] | None = None,
    sigma: Mapping[str, float] | None = None,
    among: Collection[int] | None = None,
    computed_at: np.ndarray | None = None,
) -> list[ErrorTable]:
    """Return one error table per version `(parameters, offsets by run)`, from one pass over the log.

    `reading_variance`: (K,), or (versions, K) where each version weighs readings in its own way.
    `keep(block) -> (samples,)` weights; samples of weight 0 (outliers) take no part. `sigma`: noise by
    column, for the columns that are computed; those of parameters are taken at `computed_at` (n,), by default
    the last version's. `among`: runs that are decoded, all by default.
    """
    runs: list[int] = []
    counts: list[np.ndarray] = []
    sums: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in versions]
    span: dict[str, tuple[float, float]] = {}
    known = model.named(versions[-1][0] if computed_at is None else computed_at)
    wide = extended(log, model, sigma, known)
    for batch, decoded in _decoded(wide, model, versions, reading_variance, on_rows, among):
        weights, starts = batch.weights(keep), batch.edges[:-1]
        used = np.ones(len(batch), bool) if weights is None else weights > 0
        runs += batch.runs
        counts.append(np.add.reduceat(used.astype(float), starts))
        for column in (*model.references, *model.state) if counts[-1].any() else ():
            values = batch.data[column] if weights is None else batch.data[column][used]
            low, high = span.get(column, (np.inf, -np.inf))
            least, most = float(np.minimum.reduce(values)), float(np.maximum.reduce(values))
            span[column] = (min(low, least), max(high, most))
        for error, total in zip(decoded, sums, strict=True):
            size = np.abs(error, out=error)
            if weights is not None:
                size[:, ~used] = 0.0
            peak = np.maximum.reduceat(size, starts, axis=1)
            if not np.isfinite(peak).all():
                for run, at in batch.parts():
                    check_decoded(error[:, at][:, used[at]], model, log, run)
            total.append((np.add.reduceat(np.square(size, out=size), starts, axis=1), peak))
    first = np.flatnonzero(np.diff(runs, prepend=runs[0] - 1))  # a run's blocks are consecutive
    count = np.add.reduceat(np.concatenate(counts), first)
    tables = []
    for total in sums:
        squares, peak = (np.concatenate(parts, axis=1).T for parts in zip(*total, strict=True))
        each = np.add.reduceat(squares, first), np.maximum.reduceat(peak, first)
        tables.append(ErrorTable(model.pose, tuple(runs[k] for k in first), count, *each, span))
    return tables


def _decoded(
    log: Log,
    model: Model,
    versions: Sequence[Version],
    reading_variance: np.ndarray,
    on_rows: Callable[[int], None] | None = None,
    among: Collection[int] | None = None,
) -> Iterator[tuple[Batch, list[np.ndarray]]]:
    """Yield a log with its computed columns in batches, each with the errors (n_pose, samples) by version."""
    variances = np.broadcast_to(reading_variance, (len(versions), len(model.channels)))
    errors_of, count = [pose_errors(model, v) for v in variances], len(model.offsets)
    for whole in batches(log, columns_of(model), on_rows):
        batch = whole if among is None else whole.of_runs(among)
        if not batch.runs:
            continue
        yield (
            batch,
            [
                of(p, batch.offsets(offsets, count) if offsets else np.zeros(count), batch.data)
                for (p, offsets), of in zip(versions, errors_of, strict=True)
            ],
        )


def zero_shifts(
    log: Log,
    model: Model,
    p: np.ndarray,
    offsets: Mapping[int, np.ndarray],
    reading_variance: np.ndarray,
    sigma: Mapping[str, float] | None = None,
) -> dict[str, dict[int, float]]:
    """Return by reference that repeats and run the circular mean of the decoded error, in its unit.

    That is the shift of the zero of the reference since the calibration. Other arguments as for
    `error_tables`.
    """
    own = {c: model.period[c] for c in model.references if c in model.period}
    sums: dict[str, dict[int, complex]] = {c: {} for c in own}
    wide = extended(log, model, sigma, model.named(p))
    for batch, (error,) in _decoded(wide, model, [(p, offsets)], reading_variance) if own else ():
        for column, period in own.items():
            turn = np.nan_to_num(np.exp(2j * np.pi / period * error[model.references.index(column)]))
            for run, total in zip(batch.runs, np.add.reduceat(turn, batch.edges[:-1]), strict=True):
                sums[column][run] = sums[column].get(run, 0j) + complex(total)
    return {
        column: {run: float(np.angle(total)) * own[column] / (2 * np.pi) for run, total in runs.items()}
        for column, runs in sums.items()
    }


def columns_of(model: Model) -> tuple[str, ...]:
    """Columns a model reads: references, state (computed ones too), channels."""
    return (*model.references, *model.state, *model.channels)


def logged_columns(model: Model) -> tuple[str, ...]:
    """Return the columns that a log must hold: those a model reads, and inputs of computed ones."""
    made = {c.name for c in model.computed}
    needed = [c for m in model.computed for c in m.needs] + (["t_s"] if made else [])
    return tuple(dict.fromkeys(c for c in (*columns_of(model), *needed) if c not in made))
