"""Pictures of a fit for print: what was measured, errors before and after, where they are, the parameters.

They follow Figures 9 to 12 of Chen et al., Sensors 2016, 16, 872, doi:10.3390/s16060872. A log of any length
is read in blocks and reduced to its least and greatest value per picture column, so a peak never gets lost.
Data stay in SI; axes say um, urad or mV. Colours differ in lightness and every series has its own line style
or marker, so that a greyscale print can be read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.calibration import Fit
from hallsym.errors import InputError
from hallsym.evaluate import CHUNK, ErrorTable, Mask, columns_of, decoder
from hallsym.files import atomic_write, reason
from hallsym.log import Block, Log

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 150
SUFFIXES = ("png", "pdf", "svg")
COLUMNS = 1000
"""A trace is drawn with this many to twice this many min-max columns, or with every sample if it has fewer."""
BAND = 3.0
"""Half-width of the noise band in noise floors: 99.7 % of Gaussian errors lie inside."""
COVERAGE = 1.96
"""Standard deviations in half a 95 % interval."""
LEVEL = 1e-6
"""Vertical positions [m, rad] closer than this are one setting."""
MOST_SETTINGS = 60

WIDTH = 7.1  # inches: two columns of a journal page
BLACK, GREY, FAINT, SHADE = "#000000", "#777777", "#bbbbbb", "#e6e6e6"
BEFORE, AFTER, LIGHT, GREEN = "#d55e00", "#0072b2", "#f0b070", "#009e73"  # Okabe and Ito's palette
SERIES = (AFTER, BEFORE, GREEN, "#cc79a7", BLACK, "#e69f00", "#56b4e9")
DASHES = ("-", "--", "-.", ":")
MARKERS = ("^", "v", "D", "P", "X", "<", ">")
STYLE = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "figure.titlesize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.titlelocation": "left",
    "lines.linewidth": 0.9,
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
}


def save_pictures(
    log: Log,
    fit: Fit,
    folder: str | Path,
    *,
    keep: Mask | None = None,
    steps: Mapping[str, ErrorTable] | None = None,
    suffixes: Sequence[str] = ("png",),
) -> list[Path]:
    """Draw the pictures of `fit` on `log` into `folder` (made if missing) and return the files written.

    `measured`, `errors_before_after`, `errors_by_setting`, `parameters`, and `errors_by_step` if `steps` are
    given: error tables of models between the designed and the fitted one, in the order in which they were
    reached. `keep(block) -> (samples,)` weights; samples of weight 0 (outliers) take no part and are marked.
    `suffixes`: any of png, pdf, svg. The log is read twice, in blocks.
    """
    for suffix in suffixes:
        if suffix not in SUFFIXES:
            raise InputError(
                f"Input suffixes must hold only {', '.join(SUFFIXES)}; instead received {suffix!r}."
            )
    from matplotlib import style

    folder, steps = Path(folder), dict(steps or {})
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"Cannot make the folder {folder} for pictures: {reason(error)}.") from error
    survey = look_over(log, fit, keep)
    written = []
    with style.context(["default", STYLE]):  # whatever style the caller has set
        figures = {
            "measured": measured(log, fit, survey, keep),
            "errors_before_after": errors_before_after(fit, survey),
            "errors_by_setting": errors_by_setting(fit, survey, steps),
            "parameters": parameters(fit),
        }
        if steps:
            figures["errors_by_step"] = errors_by_step(fit, survey, steps)
        for name, figure in figures.items():
            for suffix in suffixes:
                path = folder / f"{name}.{suffix}"
                atomic_write(path, partial(_write, figure, suffix))
                written.append(path)
    return written


def _write(figure: Figure, suffix: str, path: Path) -> None:
    dated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(suffix)
    figure.savefig(path, format=suffix, dpi=DPI, metadata=dated)  # the same fit gives the same file


# -- one pass over the log -------------------------------------------------------------------------------


class Trace:
    """Least and greatest value of several series per column of a picture, gathered block by block.

    `low`, `high`: (series, columns), nan where no sample was kept; a column holds `width` samples. When the
    columns are used up, neighbours are merged, so a trace never holds more than 2 x `COLUMNS`.
    """

    def __init__(self, series: int) -> None:
        """Start a trace of `series` series."""
        self.count, self.width = 0, 1
        self._low = np.full((series, 2 * COLUMNS), np.nan)
        self._high = self._low.copy()

    def add(self, values: np.ndarray) -> None:
        """Append samples, shape (series, samples); nan marks what is left out."""
        n = values.shape[1]
        while self.count + n > self.width * 2 * COLUMNS:
            self._merge()
        column = (self.count + np.arange(n)) // self.width
        starts = np.flatnonzero(np.diff(column, prepend=-1))
        at = slice(int(column[0]), int(column[-1]) + 1)
        self._low[:, at] = np.fmin(self._low[:, at], np.fmin.reduceat(values, starts, axis=1))
        self._high[:, at] = np.fmax(self._high[:, at], np.fmax.reduceat(values, starts, axis=1))
        self.count += n

    def _merge(self) -> None:
        for bounds, pick in ((self._low, np.fmin), (self._high, np.fmax)):
            bounds[:, :COLUMNS] = pick(bounds[:, ::2], bounds[:, 1::2])
            bounds[:, COLUMNS:] = np.nan
        self.width *= 2

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

    def line(self, series: int, x: np.ndarray, breaks: Sequence[int] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Return `(x, y)` of a line from least to greatest value, interrupted before samples in `breaks`."""
        y = self.low[series]
        if self.width > 1:
            x, y = np.repeat(x, 2), np.column_stack([y, self.high[series]]).ravel()
        at = [(2 if self.width > 1 else 1) * (sample // self.width) for sample in breaks]
        return np.insert(x, at, x[at]), np.insert(y, at, np.nan)


@dataclass
class _Run:
    """What a picture has to know of one run; the pairs hold the designed and the fitted model."""

    start: int
    first_state: np.ndarray
    zeros: np.ndarray
    samples: int = 0
    kept: int = 0
    squares: Any = 0.0
    peak: Any = 0.0
    pose: list[np.ndarray] = field(default_factory=list)
    state: list[np.ndarray] = field(default_factory=list)
    state_sum: Any = 0.0


@dataclass(frozen=True, eq=False)
class Survey:
    """A log as its pictures need it, for any number of samples.

    `edges`: (runs + 1,) sample numbers where runs begin. `travel`: (runs, n_pose) reference's least to
    greatest value. `state`: (runs, n_state) mean vertical state, `drift` its travel. `errors`: traces of the
    designed and the fitted model, `time`: trace of `t_s` if it is logged, `rejected`: 1 where samples were.
    """

    runs: tuple[int, ...]
    edges: np.ndarray
    travel: np.ndarray
    state: np.ndarray
    drift: np.ndarray
    designed: ErrorTable
    fitted: ErrorTable
    errors: tuple[Trace, Trace]
    time: Trace | None
    rejected: Trace
    n_rejected: int


class _Decode:
    """Pose of a block by the designed and by the fitted model, each (n_pose, samples)."""

    def __init__(self, fit: Fit) -> None:
        self.fit, self.model = fit, fit.model
        self.wired = fit.wiring or tuple((c, 1) for c in fit.model.channels)
        self.run = decoder(fit.model, np.array([fit.noise[c].value ** 2 for c in fit.model.channels]))

    def zeros(self, run: int, first_state: np.ndarray) -> np.ndarray:
        """Displacements delta / phi(0) of one run, Eq. (31)."""
        delta = self.fit.zeros.get(run)
        if delta is None or not len(self.model.zeros):
            return np.zeros(len(self.model.zeros))
        return np.asarray(delta) / np.asarray(self.model.gain(self.fit.values, first_state)).ravel()

    def readings(self, block: Block) -> list[np.ndarray]:
        return [sign * block.data[c] for c, sign in self.wired]

    def __call__(self, block: Block, zeros: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        readings, state = self.readings(block), [block.data[c] for c in self.model.state]
        designed = self.run(self.model.nominal, np.zeros_like(zeros), readings, state)
        return designed, self.run(self.fit.values, zeros, readings, state)


def look_over(log: Log, fit: Fit, keep: Mask | None = None) -> Survey:
    """Read `log` once and return what its pictures show."""
    model, decode = fit.model, _Decode(fit)
    traces = Trace(len(model.pose)), Trace(len(model.pose))
    time, rejected = Trace(1) if "t_s" in log.columns else None, Trace(1)
    columns = (*columns_of(model), *(("t_s",) if time else ()))
    runs: dict[int, _Run] = {}
    total = 0
    for block in log.blocks(columns, size=CHUNK):
        reference = np.array([block.data[c] for c in model.references])
        state = np.array([block.data[c] for c in model.state]).reshape(len(model.state), -1)
        n = reference.shape[1]
        kept = np.ones(n, dtype=bool) if keep is None else keep(block) > 0
        if block.run not in runs:
            runs[block.run] = _Run(total, state[:, 0], decode.zeros(block.run, state[:, 0]))
        run = runs[block.run]
        errors = [pose - reference for pose in decode(block, run.zeros)]
        for trace, error in zip(traces, errors, strict=True):
            trace.add(np.where(kept, error, np.nan))
        if time:
            time.add(block.data["t_s"][None])
        rejected.add(np.where(kept, np.nan, 1.0)[None])
        _gather(run, np.array(errors)[:, :, kept], reference[:, kept], state[:, kept])
        run.samples += n
        total += n
    return _survey(fit, runs, total, traces, time, rejected)


def _gather(run: _Run, errors: np.ndarray, reference: np.ndarray, state: np.ndarray) -> None:
    if not reference.shape[1]:
        return
    run.kept += reference.shape[1]
    run.squares = run.squares + np.einsum("vij,vij->vi", errors, errors)
    run.peak = np.maximum(run.peak, np.abs(errors).max(axis=2))
    run.pose = _extent(run.pose, reference)
    run.state = _extent(run.state, state)
    run.state_sum = run.state_sum + state.sum(axis=1)


def _extent(before: list[np.ndarray], values: np.ndarray) -> list[np.ndarray]:
    low, high = values.min(axis=1), values.max(axis=1)
    return [np.minimum(before[0], low), np.maximum(before[1], high)] if before else [low, high]


def _survey(
    fit: Fit, runs: Mapping[int, _Run], total: int, errors: tuple[Trace, Trace], time: Trace | None, rejected: Trace
) -> Survey:
    found, n, k = list(runs.values()), len(fit.model.pose), len(fit.model.state)
    count = np.array([r.kept for r in found], dtype=float)
    squares = np.array([r.squares if r.kept else np.zeros((2, n)) for r in found])
    peak = np.array([r.peak if r.kept else np.zeros((2, n)) for r in found])
    tables = [ErrorTable(fit.model.pose, tuple(runs), count, squares[:, v], peak[:, v]) for v in (0, 1)]
    return Survey(
        runs=tuple(runs),
        edges=np.array([*(r.start for r in found), total]),
        travel=np.array([r.pose[1] - r.pose[0] if r.kept else np.zeros(n) for r in found]),
        state=np.array([r.state_sum / r.kept if r.kept else r.first_state for r in found]),
        drift=np.array([r.state[1] - r.state[0] if r.kept else np.zeros(k) for r in found]),
        designed=tables[0],
        fitted=tables[1],
        errors=errors,
        time=time,
        rejected=rejected,
        n_rejected=int(total - count.sum()),
    )


# -- what was measured -----------------------------------------------------------------------------------


def measured(log: Log, fit: Fit, survey: Survey, keep: Mask | None = None) -> Figure:
    """Draw reference, decoded pose and readings of the runs in which each pose coordinate moves most."""
    from matplotlib.figure import Figure

    model = fit.model
    chosen = representative(survey)
    traces = _run_traces(log, fit, chosen, keep)
    n, rows = len(model.pose), len(model.pose) + 1
    figure = Figure(figsize=(WIDTH, 1.25 * rows + 0.75), layout="constrained")
    axes = figure.subplots(rows, len(chosen), sharex="col", sharey="row", squeeze=False)
    for row in range(rows):
        _label_measured(axes[row, 0], fit, row, [t.low for t in traces] + [t.high for t in traces])
    for column, (run, trace) in enumerate(zip(chosen, traces, strict=True)):
        timed = survey.time is not None
        x = trace.low[0] - trace.low[0][0] if timed else trace.samples
        for k in range(n):
            ax, scale = axes[k, column], axes[k, 0].scale_to_axis
            for series, label, look in (
                (1 + k, "reference", {"color": LIGHT, "lw": 3.2}),
                (1 + n + k, "decoded, designed parameters", {"color": GREY, "lw": 0.8, "ls": (0, (3, 1.5))}),
                (1 + 2 * n + k, "decoded, fitted", {"color": AFTER, "lw": 0.9}),
            ):
                at, y = trace.line(series, x)
                ax.plot(at, scale * y, label=label, **look)
        ax, scale = axes[n, column], axes[n, 0].scale_to_axis
        for k, channel in enumerate(model.channels):
            at, y = trace.line(1 + 3 * n + k, x)
            ax.plot(at, scale * y, color=SERIES[k % len(SERIES)], ls=DASHES[k % len(DASHES)], label=_name(channel))
        ax.set_xlabel("time in the run [s]" if timed else "sample of the run")
        axes[0, column].set_title(_run_title(fit, survey, run))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    handles, labels = axes[n, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6))
    return figure


def representative(survey: Survey, most: int = 3) -> list[int]:
    """Return up to `most` runs: for each pose coordinate the first in which it moves (nearly) most."""
    chosen: list[int] = []
    for travel in survey.travel.T:
        run = survey.runs[int(np.argmax(travel >= 0.9 * travel.max()))]
        if run not in chosen:
            chosen.append(run)
    return sorted(chosen[:most], key=survey.runs.index)


def _run_traces(log: Log, fit: Fit, chosen: Sequence[int], keep: Mask | None) -> list[Trace]:
    """Series of each trace: time, reference, designed pose, fitted pose, readings."""
    model, decode = fit.model, _Decode(fit)
    timed = "t_s" in log.columns
    n = 1 + 3 * len(model.pose) + len(model.channels)
    traces: dict[int, Trace] = {run: Trace(n) for run in chosen}
    zeros: dict[int, np.ndarray] = {}
    for block in log.blocks((*columns_of(model), *(("t_s",) if timed else ())), size=CHUNK):
        if block.run not in traces:
            if len(zeros) == len(traces):
                break
            continue
        if block.run not in zeros:
            zeros[block.run] = decode.zeros(block.run, np.array([block.data[c][0] for c in model.state]))
        designed, fitted = decode(block, zeros[block.run])
        reference = [block.data[c] for c in model.references]
        values = np.vstack([*reference, designed, fitted, *(block.data[c] for c in model.channels)])
        if keep is not None:
            values[:, ~(keep(block) > 0)] = np.nan
        time = block.data["t_s"] if timed else np.zeros(values.shape[1])
        traces[block.run].add(np.vstack([time, values]))
    return [traces[run] for run in chosen]
