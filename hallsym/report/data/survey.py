"""One pass over a log: the data of its pictures, for any number of samples; and groups of runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.estimation import Fit
from hallsym.estimation.decoding import ErrorTable, columns_of
from hallsym.estimation.prediction import Decoder
from hallsym.log import Block, Log, Weigh, extended
from hallsym.log.batches import SIZE
from hallsym.report.words import LEVEL, name, setting
from hallsym.units import readable, typeset

# -- a series of any length: least and greatest value per picture column ---------------------------------


COLUMNS = 1000
"""A long trace is drawn with this many to twice this many min-max columns, a shorter one sample by sample."""


class Trace:
    """Least and greatest value of several series per column of a picture, gathered block by block.

    `low`, `high`: (series, columns), nan where no sample was kept; a column holds `width` samples. When the
    columns are used up, neighbours are merged, so a trace never holds more than 2 x `COLUMNS`.
    """

    def __init__(self, series: int) -> None:
        """Start a trace of `series` series."""
        self.count, self.width = 0, 1
        shape = (series, 2 * COLUMNS)
        self._low, self._high = np.full(shape, np.nan), np.full(shape, np.nan)

    def add(self, values: np.ndarray) -> None:
        """Append samples, shape (series, samples); nan marks what is left out."""
        n = values.shape[1]
        while self.count + n > self.width * 2 * COLUMNS:
            for array, join in ((self._low, np.fmin), (self._high, np.fmax)):
                array[:, :COLUMNS] = join(array[:, ::2], array[:, 1::2])
                array[:, COLUMNS:] = np.nan
            self.width *= 2
        column = (self.count + np.arange(n)) // self.width
        starts = np.flatnonzero(np.diff(column, prepend=-1))
        at = slice(int(column[0]), int(column[-1]) + 1)
        self._low[:, at] = np.fmin(self._low[:, at], np.fmin.reduceat(values, starts, axis=1))
        self._high[:, at] = np.fmax(self._high[:, at], np.fmax.reduceat(values, starts, axis=1))
        self.count += n

    @property
    def low(self) -> np.ndarray:
        """Least value per column, shape (series, columns)."""
        return self._low[:, : -(-self.count // self.width)]

    @property
    def high(self) -> np.ndarray:
        """Greatest value per column, shape (series, columns)."""
        return self._high[:, : -(-self.count // self.width)]

    @property
    def samples(self) -> np.ndarray:
        """Sample number in the middle of each column."""
        return (np.arange(self.low.shape[1]) + 0.5) * self.width - 0.5


# -- a log decoded block by block, by the nominal and by the fitted parameters ---------------------------


NOMINAL, FITTED = "nominal", "fitted"


def decoded(
    log: Log, fit: Fit, keep: Weigh | None = None, versions: Sequence[str] = (NOMINAL, FITTED)
) -> Iterator[tuple[Block, np.ndarray, np.ndarray]]:
    """Yield each block of `log` with its errors (versions, n_pose, samples) and which samples count.

    The errors are in SI; samples to which `keep` gives weight 0 do not count.
    """
    decode, model = Decoder(fit), fit.model
    columns = (*columns_of(model), *(("t_s",) if "t_s" in log.columns else ()))
    sigma = {c: s.value for c, s in fit.noise.sigmas.items()}
    offsets: dict[int, np.ndarray] = {}
    for block in extended(log, model, sigma, model.named(fit.values)).blocks(columns, size=SIZE):
        if block.run not in offsets:
            offsets[block.run] = decode.offsets(block.run, np.array([block.data[c][0] for c in model.state]))
        by = {NOMINAL: None, FITTED: offsets[block.run]}
        reference = np.array([block.data[c] for c in model.references])
        errors = np.array([decode.pose(block, by[version]) - reference for version in versions])
        kept = np.ones(errors.shape[-1], dtype=bool) if keep is None else keep(block) > 0
        yield block, errors, kept


# -- what one pass finds ---------------------------------------------------------------------------------


MOST_GROUPS = 60
"""More vertical settings are shown run by run; of more runs neighbours are taken together."""

Group = tuple[str, list[int]]
"""Label and runs."""


@dataclass(frozen=True, eq=False)
class Survey:
    """The data of a log's pictures, for any number of samples.

    `state`: (runs, n_state) mean vertical state, that of the first sample where no sample counts; `drift`,
    its travel. `reach`: (n_pose + n_state, 2) least and greatest value of reference and state over all runs.
    `nominal`, `fitted`: errors by the parameters of that name.
    """

    samples: int
    state: np.ndarray
    drift: np.ndarray
    reach: np.ndarray
    nominal: ErrorTable
    fitted: ErrorTable
    timed: bool

    @property
    def runs(self) -> tuple[int, ...]:
        """The runs of the log."""
        return self.fitted.runs

    @property
    def n_rejected(self) -> int:
        """Samples that take no part."""
        return int(self.samples - self.fitted.count.sum())


def look_over(log: Log, fit: Fit, keep: Weigh | None = None) -> Survey:
    """Read `log` once and return the data of its pictures."""
    n, samples = len(fit.model.pose), 0
    first: dict[int, np.ndarray] = {}
    sums: dict[int, np.ndarray] = {}
    most: dict[int, np.ndarray] = {}
    columns = (*fit.model.references, *fit.model.state)
    for block, both, kept in decoded(log, fit, keep):
        run, errors = block.run, both[:, :, kept].reshape(2 * n, -1)
        whole = np.array([block.data[c] for c in columns])
        rows = whole[:, kept]
        added = [errors.shape[1:], np.einsum("ij,ij->i", errors, errors), rows[n:].sum(axis=1)]
        ends = [np.abs(errors).max(axis=1, initial=0.0)]
        ends += [side.max(axis=1, initial=-np.inf) for side in (-rows, rows)]
        first.setdefault(run, whole[n:, 0])
        sums[run] = sums.get(run, 0.0) + np.concatenate(added)
        most[run] = np.maximum(most.get(run, -np.inf), np.concatenate(ends))
        samples += len(kept)
    count, squares, total = np.split(np.array([*sums.values()]), [1, 1 + 2 * n], axis=1)
    peak, low, high = np.split(np.array([*most.values()]), [2 * n, 2 * n + len(rows)], axis=1)
    nominal, fitted = (
        ErrorTable(fit.model.pose, tuple(sums), count[:, 0], squares[:, at], peak[:, at])
        for at in (slice(n), slice(n, 2 * n))
    )
    known = count[:, 0] > 0
    return Survey(
        samples,
        np.where(known[:, None], total / np.maximum(count, 1.0), np.array([*first.values()])),
        np.where(known[:, None], high[:, n:] + low[:, n:], 0.0),
        np.column_stack([-low.max(axis=0), high.max(axis=0)]) if known.any() else np.zeros((len(rows), 2)),
        nominal,
        fitted,
        "t_s" in log.columns,
    )


def held_out(fit: Fit) -> tuple[int, ...]:
    """Return the holdout runs, also of a fit that was read back."""
    return fit.errors.holdout if fit.errors else fit.log.holdout


def worst_first(survey: Survey, floor: Mapping[str, float], most: int) -> list[int]:
    """Return up to `most` runs, that with the largest error first: rms of an output over its noise floor.

    An output without a noise floor counts against its own rms over all runs.
    """
    table = survey.fitted
    over = table.over()
    if over is None:
        return list(survey.runs[:most])
    usual = np.array([floor.get(c) or over["rmse"][c] or 1.0 for c in table.pose])
    size = np.sqrt(table.squares / np.maximum(table.count, 1.0)[:, None]) / usual
    order = np.argsort(-size.max(axis=1), kind="stable")
    return [survey.runs[k] for k in order[:most]]


def by_run(survey: Survey) -> list[Group]:
    """Return the runs, each a group; of many runs neighbours are one group."""
    per = -(-len(survey.runs) // MOST_GROUPS)
    parts = [list(survey.runs[k : k + per]) for k in range(0, len(survey.runs), per)]
    return [(f"{p[0]}" if len(p) == 1 else f"{p[0]}\N{EN DASH}{p[-1]}", p) for p in parts]


def settings(fit: Fit, survey: Survey) -> tuple[list[Group], str]:
    """Return `[(label, runs)]` by vertical setting and the axis title; `by_run` without settings.

    Settings are of the states that a campaign can set. Runs belong to one setting when their mean states
    agree within 2 % of what the campaign covers. A state that moves within runs, or never changes, makes no
    settings.
    """
    axes = [k for k, c in enumerate(fit.model.state) if c in fit.model.family.axes]
    if not axes or len(survey.runs) < 2:
        return by_run(survey), "run"
    state, drift = survey.state[:, axes], survey.drift[:, axes]
    spread = np.ptp(state, axis=0)
    near = np.maximum(0.02 * spread, LEVEL)
    if np.all(spread < LEVEL) or np.any(np.median(drift, axis=0) > np.maximum(0.1 * spread, 2 * LEVEL)):
        return by_run(survey), "run"
    centres: list[np.ndarray] = []
    members: list[list[int]] = []
    for run, point in zip(survey.runs, state, strict=True):
        match = [k for k, c in enumerate(centres) if np.all(np.abs(point - c) <= near)]
        if match:
            members[match[0]].append(run)
        else:
            centres.append(point)
            members.append([run])
        if len(centres) > MOST_GROUPS:
            return by_run(survey), "run"
    columns, periodic = tuple(fit.model.state[k] for k in axes), fit.model.period

    def place(k: int) -> tuple:
        moved = np.abs(centres[k]) > near
        return (int(moved.sum()), tuple(~moved), tuple(np.where(moved, centres[k], 0.0)))

    order = sorted(range(len(centres)), key=place)
    groups = [(setting(columns, centres[k], near, periodic), members[k]) for k in order]
    by_unit: dict[str, list[str]] = {}
    for column in columns:
        by_unit.setdefault(typeset(readable(column, periodic)[1]), []).append(name(column))
    units = "; ".join(f"{', '.join(names)} in {unit}" for unit, names in by_unit.items())
    return groups, f"vertical setting ({units})"
