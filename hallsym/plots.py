"""Pictures of a fit for print: what was measured, errors before and after, where they are, the parameters.

They follow Figures 9 to 12 of Chen et al., Sensors 2016, 16, 872, doi:10.3390/s16060872. A log of any length
is read in blocks and reduced to its least and greatest value per picture column, so a peak never gets lost.
Data stay in SI; axes say um, urad or mV. Colours differ in lightness and every series has its own line style
or marker, so that a greyscale print can be read.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hallsym.calibration import Fit
from hallsym.decoding import CHUNK, ErrorTable, Mask, columns_of, decoder
from hallsym.errors import InputError
from hallsym.files import atomic_write, reason
from hallsym.log import Block, Log
from hallsym.wiring import rewired

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 150
SUFFIXES = ("png", "pdf", "svg")
COLUMNS = 1000
"""A long trace is drawn with this many to twice this many min-max columns, a shorter one sample by sample."""
STRETCHES = tuple(2 * COLUMNS * 4**k for k in range(12))
"""Samples from the start of a run that are tried when the whole run would be a solid block."""
SMEAR = 0.025
"""Motion can be seen while it moves less than this share of its travel within one picture column."""
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
DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)))
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
    "lines.linewidth": 0.9,
    "path.simplify": False,
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

    `measured`, `errors_before_after`, `errors_by_setting` and `parameters`. `steps`: error tables of models
    between the designed and the fitted one, by name; they are shown by setting.
    `keep(block) -> (samples,)` weights; samples of weight 0 (outliers) take no part and are marked.
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
    log = rewired(log, fit.model.channels, fit.wiring)
    survey = look_over(log, fit, keep)
    written = []
    with style.context(["default", STYLE]):  # whatever style the caller has set
        figures = {
            "measured": measured(log, fit, survey, keep),
            "errors_before_after": errors_before_after(fit, survey),
            "errors_by_setting": errors_by_setting(fit, survey, steps),
            "parameters": parameters(fit),
        }
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

    def line(
        self, series: int, x: np.ndarray, breaks: Sequence[int] | np.ndarray = ()
    ) -> tuple[np.ndarray, np.ndarray]:
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
        self.run = decoder(fit.model, np.array([fit.noise[c].value ** 2 for c in fit.model.channels]))

    def zeros(self, run: int, first_state: np.ndarray) -> np.ndarray:
        """Displacements delta / phi(0) of one run, Eq. (31)."""
        delta = self.fit.zeros.get(run)
        if delta is None or not len(self.model.zeros):
            return np.zeros(len(self.model.zeros))
        return np.asarray(delta) / np.asarray(self.model.gain(self.fit.values, first_state)).ravel()

    def __call__(self, block: Block, zeros: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        readings, state = (
            [block.data[c] for c in names] for names in (self.model.channels, self.model.state)
        )
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
    fit: Fit,
    runs: Mapping[int, _Run],
    total: int,
    errors: tuple[Trace, Trace],
    time: Trace | None,
    rejected: Trace,
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
    traces = _run_traces(log, fit, survey, chosen, keep)
    n, rows = len(model.pose), len(model.pose) + 1
    figure = Figure(figsize=(WIDTH, 1.25 * rows + 0.75), layout="constrained")
    axes = figure.subplots(rows, len(chosen), sharex="col", sharey="row", squeeze=False)
    scales = [_scale(model.pose[k], _largest(traces, range(1 + k, 1 + 3 * n, n))) for k in range(n)]
    scales.append(_scale(model.channels[0], _largest(traces, range(1 + 3 * n, traces[0].low.shape[0]))))
    for ax, name, (_, unit) in zip(axes[:, 0], (*map(_name, model.pose), "reading"), scales, strict=True):
        ax.set_ylabel(f"{name} [{unit}]")
    figure.align_ylabels(axes[:, 0])
    for column, (run, trace) in enumerate(zip(chosen, traces, strict=True)):
        timed = survey.time is not None
        x = trace.low[0] - trace.low[0][0] if timed else trace.samples
        for k in range(n):
            look: dict[str, Any]
            for series, label, look in (
                (1 + k, "reference", {"color": LIGHT, "lw": 3.2}),
                (1 + n + k, "decoded, designed parameters", {"color": BLACK, "lw": 0.7, "ls": (0, (4, 2))}),
                (1 + 2 * n + k, "decoded, fitted", {"color": AFTER, "lw": 0.9}),
            ):
                at, y = trace.line(series, x)
                axes[k, column].plot(at, scales[k][0] * y, label=label, **look)
        for k, channel in enumerate(model.channels):
            at, y = trace.line(1 + 3 * n + k, x)
            look = {"color": SERIES[k % len(SERIES)], "ls": DASHES[k % len(DASHES)]}
            axes[n, column].plot(at, scales[n][0] * y, label=_name(channel), **look)
        axes[n, column].set_xlabel("time in the run [s]" if timed else "sample of the run")
        axes[0, column].set_title(_run_title(fit, survey, run, trace), loc="left")
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


def _run_traces(log: Log, fit: Fit, survey: Survey, chosen: Sequence[int], keep: Mask | None) -> list[Trace]:
    """Trace each chosen run from its start, as far as its motion can still be seen.

    Series: time, reference, designed pose, fitted pose, readings.
    """
    model, decode = fit.model, _Decode(fit)
    timed = survey.time is not None
    n = 1 + 3 * len(model.pose) + len(model.channels)
    sizes = dict(zip(survey.runs, np.diff(survey.edges), strict=True))
    lengths = {run: [s for s in STRETCHES if s < sizes[run]] + [sizes[run]] for run in chosen}
    traces = {run: [Trace(n) for _ in lengths[run]] for run in chosen}
    zeros: dict[int, np.ndarray] = {}
    for block in log.blocks((*columns_of(model), *(("t_s",) if timed else ())), size=CHUNK):
        if block.run not in traces:
            if len(zeros) == len(traces):
                break
            continue
        if block.run not in zeros:
            zeros[block.run] = decode.zeros(block.run, np.array([block.data[c][0] for c in model.state]))
        reference = [block.data[c] for c in model.references]
        readings = [block.data[c] for c in model.channels]
        values = np.vstack([*reference, *decode(block, zeros[block.run]), *readings])
        if keep is not None:
            values[:, ~(keep(block) > 0)] = np.nan
        time = block.data["t_s"] if timed else np.zeros(values.shape[1])
        values = np.vstack([time, *values])
        for length, trace in zip(lengths[block.run], traces[block.run], strict=True):
            if trace.count < length:
                trace.add(values[:, : length - trace.count])
    most = survey.travel.max(axis=0)

    def clear(trace: Trace) -> bool:
        rows = slice(1, 1 + len(most))
        smear = np.nanmedian(trace.high[rows] - trace.low[rows], axis=1)
        return bool(np.all(smear <= SMEAR * most))

    return [next(filter(clear, reversed(traces[run])), traces[run][0]) for run in chosen]


def _largest(traces: Sequence[Trace], series: Sequence[int]) -> float:
    return max(_top(bounds[list(series)]) for t in traces for bounds in (t.low, t.high))


def _run_title(fit: Fit, survey: Survey, run: int, trace: Trace) -> str:
    k = survey.runs.index(run)
    what = "held out" if run in _holdout(fit) else ""
    where = ""
    if len(fit.model.state) and not np.any(survey.drift[k] > 20 * LEVEL):
        where = _setting_label(fit.model.state, survey.state[k], 5 * LEVEL, units=True)
    part = ""
    if trace.count < survey.edges[k + 1] - survey.edges[k]:
        seconds = trace.high[0, -1] - trace.low[0, 0]
        part = f"first {_short(seconds)} s" if survey.time is not None else f"first {trace.count} samples"
    return ", ".join(filter(None, (f"run {run}", where, what, part)))


# -- errors along the campaign ---------------------------------------------------------------------------


def errors_before_after(fit: Fit, survey: Survey) -> Figure:
    """Draw the errors of the decoded pose over the whole campaign: designed parameters left, fitted right.

    Every sample counts: of each picture column the least and the greatest error are drawn. The two sides have
    scales of their own, and the right one says by how much it is finer.
    """
    from matplotlib.figure import Figure

    model = fit.model
    n = len(model.pose)
    figure = Figure(figsize=(WIDTH, 1.45 * n + 0.85), layout="constrained")
    axes = figure.subplots(n, 2, sharex=True, squeeze=False)
    tables, highest = (survey.designed, survey.fitted), np.zeros((n, 2))
    for column, (trace, table) in enumerate(zip(survey.errors, tables, strict=True)):
        for k, name in enumerate(model.pose):
            floor = float(fit.noise_floor.get(name, 0.0))
            peak = max(float(table.peak[:, k].max()), _top(trace.low[k]), _top(trace.high[k]))
            highest[k, column] = max(peak, 1.15 * BAND * floor) or 1e-12
            factor, unit = _scale(name, highest[k, column])
            ax = axes[k, column]
            _campaign_axis(ax, fit, survey)
            x, y = trace.line(k, _campaign_x(survey, trace), survey.edges[1:-1])
            ax.plot(x, factor * y, color=(BEFORE, AFTER)[column], lw=(0.8, 0.5)[column], zorder=2)
            for side in (-1, 1):
                ax.axhline(side * BAND * factor * floor, color=BLACK, lw=0.7, ls=(0, (4, 2)), zorder=3)
            limit = 1.08 * factor * highest[k, column]
            ax.ticklabel_format(axis="y", style="plain", useOffset=False)
            ax.set_ylim(-limit * (1.1 if survey.n_rejected else 1.0), limit)
            ax.set_ylabel(f"error in {_name(name)} [{unit}]")
            ax.set_title(_error_words(table, k, name, fit if column else None), loc="left")
    ratios = highest[:, 0] / highest[:, 1]
    finer = ", ".join(">10000" if ratio > 1e4 else _short(float(f"{ratio:.2g}")) for ratio in ratios)
    for ax in axes[-1]:
        ax.set_xlabel(_campaign_label(survey))
    for column, title in enumerate(
        ("Designed parameters, no zero deviations", f"Fitted; scales {finer} × finer")
    ):
        below = axes[0, column].get_title("left")
        axes[0, column].set_title(f"{title}\n{below}", loc="left", linespacing=1.6)
    figure.align_ylabels(axes)
    _campaign_legend(figure, fit, survey)
    return figure


def _error_words(table: ErrorTable, k: int, name: str, fit: Fit | None) -> str:
    """RMSE and peak of one coordinate; with `fit` apart for the fitted and the held-out runs."""
    held = _holdout(fit) if fit else ()
    used, apart = table.over([r for r in table.runs if r not in held]), table.over(held)
    factor, unit = _scale(name, float(table.peak[:, k].max()))
    texts = [
        f"{label} {_three(factor * row['rmse'][name])}, {word}{_three(factor * row['peak'][name])}"
        for label, word, row in (
            ("rmse", "peak ", used),
            ("held out" if used else "held out: rmse", "", apart),
        )
        if row
    ]
    return f"{'; '.join(texts)} {unit}" if texts else "no samples"


def _campaign_x(survey: Survey, trace: Trace) -> np.ndarray:
    if len(survey.runs) == 1 and survey.time is not None:
        return survey.time.low[0] - survey.time.low[0][0]
    return trace.samples


def _campaign_label(survey: Survey) -> str:
    if len(survey.runs) == 1:
        return "time [s]" if survey.time is not None else "sample"
    return "run (as wide as its number of samples)"


def _campaign_axis(ax: Axes, fit: Fit, survey: Survey) -> None:
    """Shade held-out runs, separate runs, number them, and mark rejected samples at the bottom."""
    edges, held = survey.edges - 0.5, _holdout(fit)
    x = _campaign_x(survey, survey.rejected)
    hit = np.flatnonzero(np.isfinite(survey.rejected.high[0]))
    ax.plot(x[hit], np.full(len(hit), 0.02), transform=ax.get_xaxis_transform(), ls="none", marker="|",
            ms=4, mew=0.6, color=GREY, zorder=4)  # fmt: skip
    if len(survey.runs) == 1:
        ax.set_xlim(x[0], x[-1] if x[-1] > x[0] else x[0] + 1)
        return
    for k, run in enumerate(survey.runs):
        if run in held:
            ax.axvspan(edges[k], edges[k + 1], color=SHADE, lw=0, zorder=0)
    if len(survey.runs) <= 80:
        ax.vlines(edges[1:-1], 0, 1, transform=ax.get_xaxis_transform(), color=FAINT, lw=0.3, zorder=1)
    pick = _thinned(len(survey.runs), 8)
    ax.set_xticks([float(edges[k : k + 2].mean()) for k in pick], [str(survey.runs[k]) for k in pick])
    ax.set_xlim(edges[0], edges[-1])


def _campaign_legend(figure: Figure, fit: Fit, survey: Survey) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Line2D(
            [],
            [],
            color=BLACK,
            lw=0.7,
            ls=(0, (4, 2)),
            label=f"±{BAND:g} × noise floor (99.7 % of pure noise)",
        )
    ]
    if set(_holdout(fit)) & set(survey.runs) and len(survey.runs) > 1:
        handles.append(Patch(facecolor=SHADE, label="held-out run"))
    if survey.n_rejected:
        label = f"rejected sample ({survey.n_rejected})"
        handles.append(Line2D([], [], color=GREY, ls="none", marker="|", ms=6, label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


# -- errors by vertical setting --------------------------------------------------------------------------


def errors_by_setting(fit: Fit, survey: Survey, steps: Mapping[str, ErrorTable] | None = None) -> Figure:
    """Draw rmse by vertical setting (by run where there are no settings) before, after and for `steps`."""
    from matplotlib.figure import Figure

    model, floors = fit.model, fit.noise_floor
    groups, title = settings(fit, survey)
    held, aside = _holdout(fit), np.zeros(len(groups))
    used = [[r for r in runs if r not in held] for _, runs in groups]
    apart = [[r for r in runs if r in held] for _, runs in groups]
    every = [runs for _, runs in groups]
    size = 4.2 if len(groups) <= 2 * MOST_SETTINGS else 2.0
    series: list[tuple[str, ErrorTable, list[list[int]], dict[str, Any]]] = [
        ("designed", survey.designed, every, {"marker": "s", "mfc": "white", "color": BEFORE})
    ]
    for k, (label, table) in enumerate((steps or {}).items()):
        look = {"marker": MARKERS[k % len(MARKERS)], "mfc": "white", "color": SERIES[(k + 2) % len(SERIES)]}
        series.append((label, table, every, look))
    series.append(("fitted", survey.fitted, used, {"marker": "o", "mfc": AFTER, "color": AFTER}))
    if any(apart):
        look = {"marker": "D", "mfc": "white", "color": AFTER}
        aside = np.array([0.25 if u and a else 0.0 for u, a in zip(used, apart, strict=True)])
        series.append(("fitted, held-out runs", survey.fitted, apart, look))
    n = len(model.pose)
    figure = Figure(figsize=(WIDTH, 1.5 * n + 1.5), layout="constrained")
    axes = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    for k, (ax, name) in enumerate(zip(axes, model.pose, strict=True)):
        values = [[_rmse(table, runs, k) for runs in sets] for _, table, sets, _ in series]
        floor = float(floors.get(name, 0.0))
        factor, unit = _scale(name, _top(np.array(values)))
        for (label, _, sets, look), y in zip(series, values, strict=True):
            x = np.arange(len(y)) + (aside if sets is apart else 0.0)
            ax.plot(x, factor * np.array(y), ls="none", ms=size, label=label, zorder=3, **look)
        if len(groups) <= MOST_SETTINGS:
            ax.vlines(
                np.arange(len(groups)), *_reach(factor * np.array(values)), color=FAINT, lw=0.6, zorder=1
            )
        if floor > 0:
            ax.axhline(factor * floor, color=BLACK, lw=0.8, ls=(0, (4, 2)), label="noise floor", zorder=2)
        _log_axis(ax, "y", factor * np.array([*np.ravel(values), floor]))
        ax.grid(axis="y", which="major", color=SHADE, lw=0.5, zorder=0)
        ax.set_ylabel(f"rmse {_name(name)} [{unit}]")
    pick = range(len(groups)) if len(groups) <= MOST_SETTINGS else _thinned(len(groups), 12)
    words = any(not label.lstrip("-").isdigit() for label, _ in groups)
    axes[-1].set_xticks(list(pick), [groups[k][0] for k in pick], rotation=90 if words else 0)
    if len(pick) > 30:
        axes[-1].tick_params("x", labelsize=7, rotation=90)
    axes[-1].set_xlim(-0.7, len(groups) - 0.3)
    axes[-1].set_xlabel(title)
    handles, labels = axes[0].get_legend_handles_labels()
    columns = -(-len(labels) // -(-len(labels) // 6))
    figure.legend(
        handles, labels, loc="outside upper center", ncols=columns, handlelength=1.8, columnspacing=1.4
    )
    figure.align_ylabels(axes)
    return figure


def settings(fit: Fit, survey: Survey) -> tuple[list[tuple[str, list[int]]], str]:
    """Return `[(label, runs)]` by vertical setting and the axis title; one entry per run without settings.

    Runs belong to one setting when their mean vertical states agree within 2 % of what the campaign covers.
    A state that moves within runs, or never changes, makes no settings.
    """
    axes = [k for k, c in enumerate(fit.model.state) if c.endswith(("_m", "_rad"))]
    state, drift = survey.state[:, axes], survey.drift[:, axes]
    by_run = [(str(run), [run]) for run in survey.runs]
    if not axes or len(survey.runs) < 2:
        return by_run, "run"
    spread = np.ptp(state, axis=0)
    near = np.maximum(0.02 * spread, LEVEL)
    if np.all(spread < LEVEL) or np.any(np.median(drift, axis=0) > np.maximum(0.1 * spread, 2 * LEVEL)):
        return by_run, "run"
    centres: list[np.ndarray] = []
    members: list[list[int]] = []
    for run, point in zip(survey.runs, state, strict=True):
        match = [k for k, c in enumerate(centres) if np.all(np.abs(point - c) <= near)]
        if match:
            members[match[0]].append(run)
        else:
            centres.append(point)
            members.append([run])
        if len(centres) > MOST_SETTINGS:
            return by_run, "run"
    names = tuple(fit.model.state[k] for k in axes)

    def place(k: int) -> tuple:
        moved = np.abs(centres[k]) > near
        return (int(moved.sum()), tuple(~moved), tuple(np.where(moved, centres[k], 0.0)))

    order = sorted(range(len(centres)), key=place)
    shown = "; ".join(
        f"{', '.join(_name(c) for c in names if _unit(c) == unit)} in {_MICRO[unit]}"
        for unit in dict.fromkeys(map(_unit, names))
    )
    labels = [_setting_label(names, centres[k], near) for k in order]
    return [
        (label, members[k]) for label, k in zip(labels, order, strict=True)
    ], f"vertical setting ({shown})"


def _setting_label(names: Sequence[str], point: np.ndarray, near: Any, *, units: bool = False) -> str:
    """`Z +250 Rx -500`, in um and urad; what is within `near` of zero is left out."""
    parts = [
        f"{_name(c)} {1e6 * v:+.{0 if abs(v) >= 10e-6 else 1}f}".replace("-", "\N{MINUS SIGN}")
        + (f" {_MICRO.get(_unit(c), '')}" if units else "")
        for c, v, least in zip(names, point, np.broadcast_to(near, len(names)), strict=True)
        if abs(v) > least
    ]
    return " ".join(parts) or "level"


def _rmse(table: ErrorTable, runs: Sequence[int], k: int) -> float:
    pick = [table.runs.index(run) for run in runs if run in table.runs]
    count = float(table.count[pick].sum()) if pick else 0.0
    return float(np.sqrt(table.squares[pick, k].sum() / count)) if count else float("nan")


def _reach(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest of the series at each setting; nan where there is none."""
    return np.fmin.reduce(values), np.fmax.reduce(values)


def _log_axis(ax: Axes, which: str, values: np.ndarray) -> None:
    """Logarithmic x or y axis around the positive values, with plain numbers at 1, 2, 5 of each decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    values = values[np.isfinite(values) & (values > 0)]
    if not len(values):
        return
    low, top = float(values.min()), float(values.max())
    decades = float(np.log10(top / low))
    margin = 1.5 * 10 ** (0.04 * decades)
    ax.set(**{f"{which}scale": "log", f"{which}lim": (low / margin, top * margin)})
    axis = getattr(ax, f"{which}axis")
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if decades < 1.4 else (1, 3) if decades < 2.6 else (1,)))
    axis.set_major_formatter(FuncFormatter(lambda v, _: _short(v)))
    axis.set_minor_formatter(NullFormatter())


# -- parameters ------------------------------------------------------------------------------------------


def parameters(fit: Fit) -> Figure:
    """Draw every parameter within its bounds, how narrow its 95 % interval is, and the numbers to copy.

    Left: nominal value and estimate, 0 at the lower and 1 at the upper bound; hollow where the data do not
    determine it. Middle: half the 95 % interval as a share of the bounds. Combinations that the data
    determine instead stand below.
    """
    from matplotlib.figure import Figure

    model, n = fit.model, len(fit.model.parameters)
    below = [(textwrap.wrap(_typeset(c.expression), 84), c) for c in fit.combinations]
    extra = sum(len(lines) for lines, _ in below) + 1.5 if below else 0.0
    figure = Figure(figsize=(WIDTH, 0.155 * (n + extra) + 1.05), layout="constrained")
    ratios = (n + 0.2, extra) if below else (1,)
    grid = figure.add_gridspec(len(ratios), 2, width_ratios=(3, 2), wspace=0.08, height_ratios=ratios)
    place = figure.add_subplot(grid[0, 0])
    sharp = figure.add_subplot(grid[0, 1], sharey=place)
    for row in range(n):
        _parameter_row(place, sharp, fit, row)
        _beside(sharp, row, _number_words(fit, row))
    _beside(sharp, -1.1, "estimate ± 95 %")
    place.set_yticks(range(n), model.names)
    place.tick_params("y", length=0)
    sharp.tick_params("y", length=0, labelleft=False)
    place.set_ylim(n - 0.4, -0.6)
    place.set_xlim(-0.04, 1.04)
    place.set_xlabel("position within the bounds")
    place.set_xticks((0, 0.25, 0.5, 0.75, 1), ("lower", "", "middle", "", "upper"))
    _precision_axis(sharp, fit)
    if below:
        _combinations(figure.add_subplot(grid[1, :]), below, extra)
    _parameter_legend(figure, fit)
    return figure


def _beside(ax: Axes, row: float, text: str) -> None:
    """Write to the right of a row."""
    look: dict[str, Any] = {"va": "center_baseline", "annotation_clip": False, "textcoords": "offset points"}
    ax.annotate(text, (1.0, row), xycoords=ax.get_yaxis_transform(), xytext=(6, 0), **look)


def _combinations(ax: Axes, below: Sequence[tuple[list[str], Any]], rows: float) -> None:
    """List what the data determine instead of single parameters."""
    ax.set_axis_off()
    ax.set_ylim(rows - 0.4, -0.6)
    ax.text(0.0, 0.0, "Determined instead", va="center_baseline", in_layout=False)
    row = 1
    for lines, c in below:
        for k, line in enumerate(lines):
            indent = 0.03 if k else 0.01
            ax.text(indent, row + k, line, va="center_baseline", in_layout=False)
        _beside(ax, row + len(lines) - 1, _plus_minus(c.value, COVERAGE * c.std, c.unit))
        row += len(lines)


def _typeset(expression: str) -> str:
    return re.sub(r"(?<!e)-", "\N{MINUS SIGN}", expression.replace("*", " "))


def _parameter_row(place: Axes, sharp: Axes, fit: Fit, row: int) -> None:
    p, value = fit.model.parameters[row], float(fit.values[row])
    if row % 2 == 0:
        for ax in (place, sharp):
            ax.axhspan(row - 0.5, row + 0.5, color="#f4f4f4", lw=0, zorder=0)
    if not (np.isfinite(p.width) and p.width > 0):
        place.text(
            0.5, row, "fixed" if p.width == 0 else "no bounds", ha="center", va="center_baseline", color=GREY
        )
        return
    at, nominal = (value - p.lower) / p.width, (p.nominal - p.lower) / p.width
    known = bool(fit.determined[row])
    shown = min(max(nominal, -0.03), 1.03)
    mark = "|" if shown == nominal else ">" if nominal > 1 else "<"
    place.plot([shown, at], [row, row], color=FAINT, lw=0.8, zorder=1)
    place.plot(
        shown, row, marker=mark, ms=6 if mark == "|" else 4, mew=1.2, color=BEFORE, ls="none", zorder=2
    )
    edge = p.name in fit.at_bound
    place.plot(at, row, marker="s" if edge else "o", ms=4.2, mfc=AFTER if known or edge else "white",
               color=AFTER, ls="none", zorder=3)  # fmt: skip
    if known:
        half = COVERAGE * float(fit.std[row]) / p.width
        place.plot([at - half, at + half], [row, row], color=AFTER, lw=1.4, zorder=2, solid_capstyle="butt")
        if half > 0:
            sharp.plot(100 * half, row, marker="o", ms=4.2, color=AFTER, ls="none", zorder=3)


def _number_words(fit: Fit, row: int) -> str:
    """The estimate with its interval, or why there is none."""
    p = fit.model.parameters[row]
    if p.width == 0:
        return "fixed"
    if p.name in fit.at_bound:
        return "at its bound"
    if fit.determined[row]:
        return _plus_minus(float(fit.values[row]), COVERAGE * float(fit.std[row]), p.unit)
    return "not determined, held" if p.name in fit.held else "not determined"


def _precision_axis(ax: Axes, fit: Fit) -> None:
    model = fit.model
    width = np.array([p.width for p in model.parameters])
    with np.errstate(divide="ignore", invalid="ignore"):
        half = 100 * COVERAGE * fit.std / width
    half = half[np.isfinite(half) & (half > 0)]
    ax.set_xlabel("half of the 95 % interval\n[% of the bounds' width]")
    if len(half):
        _log_axis(ax, "x", np.array([*half, 0.1, 1.0]))
    else:
        ax.set_xticks([])


def _parameter_legend(figure: Figure, fit: Fit) -> None:
    from matplotlib.lines import Line2D

    point: dict[str, Any] = {"ls": "none", "ms": 4.2, "color": AFTER}
    handles = [
        Line2D([], [], ls="none", marker="|", ms=6, mew=1.2, color=BEFORE, label="nominal"),
        Line2D([], [], marker="o", **point, label="estimate"),
    ]
    lower, upper = fit.model.bounds
    if np.any((fit.model.nominal < lower - 0.03 * (upper - lower)) | (fit.model.nominal > upper)):
        beyond = Line2D([], [], ls="none", marker=">", ms=4, color=BEFORE, label="nominal beyond the bounds")
        handles.insert(1, beyond)
    if fit.at_bound:
        handles.append(Line2D([], [], marker="s", **point, label="estimate at its bound"))
    if not np.all(fit.determined):
        handles.append(Line2D([], [], marker="o", mfc="white", **point, label="not determined by the data"))
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))


# -- names, units, numbers -------------------------------------------------------------------------------

_LADDER: Mapping[str, tuple[tuple[float, float, str], ...]] = {
    "m": ((2e-8, 1e9, "nm"), (2e-2, 1e6, "µm"), (np.inf, 1e3, "mm")),
    "rad": ((2e-8, 1e9, "nrad"), (2e-2, 1e6, "µrad"), (2.0, 1e3, "mrad"), (np.inf, 1.0, "rad")),
    "v": ((0.5, 1e3, "mV"), (np.inf, 1.0, "V")),
    "degc": ((np.inf, 1.0, "°C"),),
}
"""By SI unit of a column: up to this value, times this factor, in this unit."""


_MICRO = {"m": "µm", "rad": "µrad"}


def _unit(column: str) -> str:
    return column.rpartition("_")[2]


def _scale(column: str, largest: float) -> tuple[float, str]:
    """Factor and unit in which values of a column up to `largest` are read easily."""
    ladder = _LADDER.get(_unit(column), ((np.inf, 1.0, _unit(column)),))
    return next((factor, unit) for top, factor, unit in ladder if not largest > top)


def _name(column: str) -> str:
    """What people call a column: `rz_rad` is Rz, `hall_a_m` is Hall A."""
    stem = column.rpartition("_")[0] or column
    if stem.startswith("hall_"):
        return f"Hall {stem.removeprefix('hall_').upper()}"
    return stem.capitalize() if stem in ("z", "rx", "ry", "rz") else stem.replace("_", " ")


def _top(values: np.ndarray) -> float:
    """Largest magnitude that is finite; 0 if there is none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def _short(value: float) -> str:
    """Three significant digits without an exponent, with one where there would be many zeros."""
    if value == 0 or not np.isfinite(value) or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.3g}"
    return np.format_float_positional(float(f"{value:.3g}"), trim="-")


def _three(value: float) -> str:
    """Three significant digits, trailing zeros kept."""
    if 100 <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:#.3g}" if 1e-4 <= abs(value) < 100 else f"{value:.3g}"


def _plus_minus(value: float, half: float, unit: str) -> str:
    """`value ± half` with two digits of `half`; metres in mm, radians in mrad."""
    factor, unit = {"m": (1e3, " mm"), "rad": (1e3, " mrad"), "1": (1.0, "")}.get(unit, (1.0, f" {unit}"))
    value, half = factor * value, factor * half
    if not (np.isfinite(half) and half > 0):
        return f"{value:.6g}{unit}"
    digits = int(np.clip(1 - np.floor(np.log10(half)), 0, 12))
    return f"{value:.{digits}f} ± {half:.{digits}f}{unit}".replace("-", "\N{MINUS SIGN}")


def _holdout(fit: Fit) -> tuple[int, ...]:
    """Held-out runs, also of a fit that was read back."""
    return fit.errors.holdout if fit.errors else tuple(fit.log.get("holdout", ()))


def _thinned(n: int, most: int) -> Sequence[int]:
    """Every k-th of n indices, k from 1, 2, 5, 10, .., at most about `most` of them."""
    step = next(s * 10**e for e in range(12) for s in (1, 2, 5) if n <= most * s * 10**e)
    return range(0, n, step)
