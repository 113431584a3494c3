"""The setup of a diagnosis: the log, its fit, the fitted and the holdout runs, the catalogue."""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.diagnosis.decoded_errors import FIRST, errors_of
from hallsym.diagnosis.p_values import statistic_at
from hallsym.diagnosis.policy import POLICY, Policy
from hallsym.diagnosis.residuals import FOLDS, NIL, Base, found_once
from hallsym.diagnosis.survey import products_at_lags
from hallsym.errors import InputError, counted, require
from hallsym.estimation.calibration import Fit
from hallsym.estimation.claims import assigned
from hallsym.estimation.decoding import logged_columns
from hallsym.estimation.fit import ALL, fit
from hallsym.estimation.goodness_of_fit import noise_floor
from hallsym.estimation.likelihood import Cost, Point, cost_near
from hallsym.estimation.task import noise_of
from hallsym.families import build, default_model
from hallsym.families.faults import FAULTS
from hallsym.families.recording import Assignment, as_read, corrected
from hallsym.log import Log, clean_log, usable
from hallsym.log.batches import remembered
from hallsym.log.phase import at_rest, continuous
from hallsym.log.quality.scan import FEWEST_SAMPLES
from hallsym.model import Effect, Model

Say = Callable[[str], None]


@dataclass(frozen=True)
class Floor:
    """Decoded error by noise alone on some runs: rmse by output, and as gap metric [m or rad].

    `uncertain`: factor within which it is known, 1 if stated.
    """

    outputs: Mapping[str, float]
    metric: float
    uncertain: float = 1.0

    @property
    def least(self) -> float:
        """The least error by noise: an estimate may include steps between readings."""
        return self.metric / self.uncertain


@dataclass(frozen=True, eq=False)
class Setup:
    """The input of every stage of a diagnosis, which none changes.

    `log`: as it was fitted, with the channels as they were logged. `base`: the fit as the point where
    tangents are taken, channels assigned. `holdout`: the runs that judge. `threshold`: relative decrease of
    the gap metric that counts. `split`: whether the runs are pieces of one recording. `say`: reports
    progress. `budget`: seconds within which the diagnosis ends, None: without limit. `prepared`: when the
    preparation that `began` had ended.
    """

    log: Log
    fit: Fit
    base: Base
    holdout: tuple[int, ...]
    threshold: float
    split: bool
    catalogue: tuple[Effect, ...]
    say: Say
    began: float
    budget: float | None = None
    prepared: float = field(default_factory=lambda: perf_counter())

    @property
    def part(self) -> "Setup":
        """The same on the part of a long log on which effects are searched."""
        base = self.base.part
        return self if base is self.base else replace(self, base=base)

    @cached_property
    def runs(self) -> list[int]:
        """The runs that are fitted."""
        return [run for run in self.base.log.runs if run not in self.holdout]

    @cached_property
    def floor(self) -> Floor:
        """The error by noise alone on the holdout runs."""
        return self._floor(self.holdout)

    @cached_property
    def floor_fitted(self) -> Floor:
        """The same on the fitted runs: of a magnet array, noise moves the pose by more at a wider gap."""
        return self._floor(self.runs)

    def _floor(self, runs: Iterable[int]) -> Floor:
        rmse = noise_floor(point_on(self.base, runs))
        metric = float(np.linalg.norm(self.base.pose_weights * list(rmse.values())))
        return Floor(rmse, metric, self.fit.goodness.uncertain if self.fit.goodness else 1.0)

    def over(self, ahead: float = 0.0) -> bool:
        """Return whether the search has used up its budget, so many seconds from now.

        What is found is judged after the search, in about the time of the preparation.
        """
        judged = self.prepared - self.began
        return self.budget is not None and self.elapsed + ahead + judged >= self.budget

    @property
    def elapsed(self) -> float:
        """Seconds since the diagnosis began."""
        return perf_counter() - self.began

    @property
    def policy(self) -> Policy:
        """The thresholds."""
        return self.base.policy

    @property
    def tested(self) -> int:
        """Hypotheses that every p-value is corrected for: effects of the catalogue and faults."""
        return len(self.catalogue) + len(FAULTS)

    @property
    def held_out(self) -> str:
        """The unit of the holdout: a run, or a piece of a recording with too few."""
        piece = "time slice" if self.base.timed else "knot group"
        return f"holdout {piece if self.split else 'run'}"

    @property
    def miswired(self) -> Assignment | None:
        """The channel assignment that was found, where channels are exchanged or inverted; else None.

        The side of a sensor is no fault, unless the log states its model, which has a side.
        """
        model, found = self.fit.model, self.fit.assignment
        if self.fit.reversed and not self.log.meta.base_model:
            return None
        if found is None or len(model.channels) == 1:  # the sign of one channel is a direction
            return None
        wrong = any(source != c or sign < 0 for c, (source, sign) in zip(model.channels, found, strict=True))
        return found if wrong else None

    def as_logged(self, base: Base) -> Base:
        """Return `base` on all samples, with the channels as they were logged."""
        return replace(base, keep=None, log=self.log) if self.miswired else base.on_all


def base_of(log: Log, result: Fit) -> Base:
    """Return a fit as the point at which tangents are taken."""
    wired = as_read(log, result.model, result.corrections)
    sigma = result.noise.std
    cost = cost_near(wired, result.model, result.values, sigma, result.keep)
    point = cost.at(result.values)
    return Base(
        log=wired,
        model=result.model,
        p=np.array(result.values, dtype=float),
        offsets=dict(zip(cost.summary.runs, point.offsets, strict=True)),
        covariance=point.covariance.mean(axis=0),
        free=tuple(k for k, n in enumerate(result.model.names) if n not in result.not_free),
        pose_weights=result.model.family.pose_metric.weights(result.model.pose, log.meta.gap_length_scale_m),
        holdout=frozenset(result.log.holdout),
        sigma=sigma,
        keep=result.keep and remembered(result.keep, wired.rows),
    )


def point_on(base: Base, runs: Iterable[int]) -> Point:
    """Return the likelihood of `base` on some runs, at its parameters."""
    cost = _cost(base, ())
    among = np.isin(cost.summary.runs, list(runs))
    return replace(cost, weights=cost.weights * among).at(base.p)


@found_once
def _cost(base: Base, _: frozenset[int]) -> Cost:
    return cost_near(base.log, base.model, base.p, base.sigma, base.keep)


def prepare(
    log: Log,
    model: str | Model | Fit | None = None,
    *,
    holdout: Sequence[int] | None = None,
    effects: Sequence[Effect] = (),
    threshold: float | None = None,
    drop_bad: bool = False,
    budget: float | None = None,
    policy: Policy = POLICY,
    on_progress: Say | None = None,
) -> Setup:
    """Fit the model to the fitted runs: the start of every stage of a diagnosis and of the detection power.

    Arguments as for `diagnose`.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    model = model.model if isinstance(model, Fit) else model or default_model(log.meta)
    model = model if isinstance(model, Model) else build(model, meta=log.described)
    level = log.meta.gap_threshold_rel or policy.worth_reporting if threshold is None else float(threshold)
    require(0 < level < 1, "Input threshold of diagnose", "between 0 and 1", level)
    timed = TIME in log.columns
    require(budget is None or budget >= 0, "Input budget of diagnose", "0 s or more", budget)
    log, drop_bad = readable(at_rest(log, model), model, drop_bad)
    whole = log
    chosen, pieces = _whole_runs(log, holdout, policy), tuple[int, ...]()
    known = None if timed else _known(log, model)
    if known is not None:
        log = replace(log, noise=known.noise)
    if not chosen and holdout is None:
        log, pieces = _pieces(log, model, known, policy)
    if TIME not in log.columns:
        log = counted_off(log)
    chosen, sliced = chosen or pieces, log.recording is not None
    if not chosen:
        raise _too_short(log, policy)
    say("fitting the model")
    asked: dict[str, Any] = {
        "solver": "direct", "holdout": chosen, "loss": "auto" if timed or not pieces else "none",
        "drop_bad": drop_bad, "on_progress": say,
    }  # fmt: skip
    inspected = _inspecting(model, whole) if pieces else model
    result = fit(log, inspected, accept=(ALL,), **asked)
    amiss = result.goodness and result.goodness.sentence
    if amiss and (wires := assigned(corrected(log, result.corrections), result.model)):
        undone = [one.text for one in (*result.corrections, *wires)]
        result = fit(log, inspected, corrections=undone, accept=(ALL,), **asked)
    result = result.changed(model=model)
    base = base_of(log, result)
    if (part := base.part) is not base:
        long = (
            f"The log is long: effects were searched on {part.log.rows} of its {log.rows} samples, in "
            "stretches over all of it; what was found is fitted to and judged on all samples."
        )
        result = result.changed(notes=(*result.notes, long))
    if arrow := sys.modules.get("pyarrow"):  # frees the memory that reading the file took
        arrow.default_memory_pool().release_unused()
    return Setup(
        log=log,
        fit=result,
        base=replace(base, model=model.family.direct(base.model), timed=timed, sliced=sliced, policy=policy),
        holdout=chosen,
        threshold=level,
        split=bool(pieces),
        catalogue=(*model.family.catalogue, *effects),
        say=say,
        began=began,
        budget=budget,
    )


def _pieces(log: Log, model: Model, known: Fit | None, policy: Policy) -> tuple[Log, tuple[int, ...]]:
    """Split a recording of too few runs if runs have no offsets; return the pieces to hold out.

    `known`: its fit if it has no time.
    """
    if log.rows < fewest(policy) or model.offsets or log.meta.holdout:
        return log, ()
    # a turn continues from piece to piece: a short turn of the reference counts from one zero
    log = continuous(replace(log, noise=noise_of(log, model)), model)
    return split(log, policy, *(() if known is None else _first_fit(log, known, policy)))


def _known(log: Log, model: Model) -> Fit | None:
    """Return the fit of a log without time, whose noise shows only between neighbouring knots."""
    try:
        return fit(log, model, solver="direct", accept=(ALL,))
    except InputError:
        return None  # the fit of the groups raises it again


def _first_fit(log: Log, found: Fit, policy: Policy) -> tuple[np.ndarray | None, int]:
    """Return which knots are spikes among their neighbours, and the number of knots in a block.

    Blocks have the correlation length of the residual, so that no block predicts its neighbours.
    """
    spikes = None
    if found.keep is not None and found.source is not None:
        spikes = np.concatenate([found.keep(block) for block in found.source.blocks()]) == 0
    base = replace(base_of(counted_off(log), found.changed(keep=None)), policy=policy)
    remembers = _remembers(base, spikes)
    return spikes, 1 if remembers < 2 else int(policy.memories * remembers)


def _remembers(base: Base, spikes: np.ndarray | None) -> int:
    """Return the correlation length of the decoded error in knots, without lines and periodic parts.

    It ends where white noise may be as correlated (Bartlett).
    """
    model, n, decode = base.model, base.log.rows, errors_of(base)
    error = base.pose_weights[:, None] * np.hstack([decode(block) for block in base.log.blocks()])
    shapes = [np.ones(n)]
    for place in (base.log.array(c) / model.period.get(c, np.inf) for c in model.references):
        shapes += [base.log.array(c) for c in model.references]
        turn = 2 * np.pi * place * np.arange(1, FIRST + 1)[:, None]
        shapes += [*np.cos(turn), *np.sin(turn)]
    columns = np.array([x / max(float(np.abs(x).max()), 1e-300) for x in shapes])
    if spikes is not None:
        error, columns = error[:, ~spikes], columns[:, ~spikes]
    error -= np.linalg.lstsq(columns.T, error.T, rcond=NIL)[0].T @ columns
    own = products_at_lags(error)
    chance = np.sqrt(statistic_at(base.policy.false_alarm, 1) / error.size)
    return int(np.argmax(np.append(own[1:] < chance * own[0], True))) + 1


def _inspecting(model: Model, whole: Log) -> Model:
    """Return the model with inspection notes of the `whole` recording, since its pieces are no runs."""
    inspect = model.inspect
    if not inspect:
        return model
    return replace(model, inspect=lambda m, log: replace(inspect(m, log), notes=inspect(m, whole).notes))


def readable(log: Log, model: Model, drop_bad: bool) -> tuple[Log, bool]:
    """Return the log without unusable samples, and whether unreadable ones were left out."""
    columns = logged_columns(model)
    if not drop_bad:
        with suppress(InputError):
            good, notes = usable(log, columns)
            return (replace(good, notes=tuple(notes)) if good.rows < log.rows else log), False
    return clean_log(log, columns), True


def _whole_runs(log: Log, holdout: Sequence[int] | None, policy: Policy) -> tuple[int, ...]:
    """Return the holdout runs: as asked, the log's own, else every fifth; none if fewer than 2 are left."""
    if holdout is None:
        every = policy.holdout_every
        holdout = [r for r in log.meta.holdout if r in log.runs] or log.runs[every // 2 :: every]
    return tuple(holdout) if len(log.runs) - len(set(holdout)) >= 2 else ()


def _too_short(log: Log, policy: Policy) -> InputError:
    """Return the error for a log that is too short for a holdout."""
    least, few = fewest(policy), "too few to hold any out and still choose an effect on the others"
    short = log.rows < least
    if short and len(log.runs) == 1 and not log.timed:
        return InputError(f"{log.name} has {log.rows} samples, {few}; record at least {least}.")
    enough = f"at least {least} samples (it has {log.rows})." if short else "split a long one."
    return InputError(
        f"{log.name} has {counted(len(log.runs), 'run')}, {few} (2 to fit and 1 to judge on at least); "
        f"record more runs or {enough}"
    )


# -- pieces of a recording -----------------------------------------------------------------------------------


TIME = "t_s"


def fewest(policy: Policy) -> int:
    """Return the least number of samples of a recording that is split into pieces."""
    return policy.fewest * FEWEST_SAMPLES


def split(
    log: Log, policy: Policy, spikes: np.ndarray | None = None, length: int = 1
) -> tuple[Log, tuple[int, ...]]:
    """Return the log in pieces as runs, with a note that says how it was done, and the pieces to hold out.

    With time, pieces are stretches of it; every second is holdout. Without, samples are knots, of which every
    second is holdout, or every second stretch of at least `length` where knots predict their neighbours; a
    counter stands for the time that the log does not have. `spikes` (samples,) are left out.
    """
    n, timed = log.rows, TIME in log.columns
    at, count = np.arange(n), piece_count(n, timed, length, policy)
    piece = at * count // n if timed or length > 1 else knot_group(at, count)
    chosen = tuple(range(1, count, 2))
    order = np.argsort(piece, kind="stable")
    notes = []
    if spikes is not None and spikes.any():
        order = order[~spikes[order]]
        gone = int(spikes.sum())
        are = "is an isolated spike and was" if gone == 1 else "are isolated spikes and were"
        notes.append(f"{gone} of {n} knots {are} left out.")
    columns = {c: log.array(c)[order] for c in log.columns if c != "run"}
    columns = {TIME: at[: len(order)].astype(float)} | columns | {"run": piece[order]}
    knots = (
        "groups of single knots, each round the turn" if length == 1 else f"stretches of {n // count} knots"
    )
    how = f"{count} {'slices of time' if timed else knots}"
    short = Log.from_arrays(columns, log.noise, replace(log.meta, holdout=chosen), log.name)
    short = of_recording(short) if timed else short
    what = counted(len(log.runs), "run") if timed or len(log.runs) > 1 else "A table of knots"
    notes.append(f"{what} cannot be held out whole: taken as {how}, every other one as holdout.")
    return replace(short, notes=(*log.notes, *notes), path=log.path, counted=not timed), chosen


def of_recording(log: Log) -> Log:
    """Return a log whose runs are slices of one recording, one after the other, with that recording."""
    whole = {c: log.array(c) for c in log.columns if c != "run"} | {"run": np.zeros(log.rows, dtype=int)}
    return replace(log, recording=Log.from_arrays(whole, log.noise, log.meta, log.name))


def counted_off(log: Log) -> Log:
    """Return a log without time with a counter in its place; its runs stay."""
    columns = {TIME: np.arange(log.rows, dtype=float)} | {c: log.array(c) for c in log.columns}
    counter = Log.from_arrays(columns, log.noise, log.meta, log.name)
    return replace(counter, notes=log.notes, path=log.path, counted=True)


def piece_count(n: int, timed: bool, length: int, policy: Policy) -> int:
    """How many pieces of `n` samples: those fitted are the folds, or as many as have the samples of a run.

    With time there are up to 100 of them: a score of 50 is nearly Gaussian, and enough pieces are in motion
    if a machine rests half of the time. Of knots an odd number is fitted, so that each group takes every
    phase of a pattern of two or four; groups extend round the turn, so that its waves stay orthogonal.
    """
    lasting = int(10 * policy.memories)  # slices of noise that is correlated over ten samples are independent
    if timed and n >= 2 * FOLDS * lasting:
        return min(100, n // lasting // 2 * 2)
    at = np.arange(n)
    for count in range(2 * FOLDS, policy.fewest, -4):  # half of it stays odd
        whole = timed or length > 1
        smallest = n // count if whole else int(np.bincount(knot_group(at, count), minlength=count).min())
        if smallest >= max(FEWEST_SAMPLES, length):
            return count
    return policy.fewest


def knot_group(at: np.ndarray, count: int) -> np.ndarray:
    """Return the group of `count` that each knot belongs to; odd groups are the holdout.

    Of four knots every second is holdout, in the next four the others, so that a pattern of two or four
    knots (a stepper's) is seen on both sides.
    """
    return 2 * (at // 2 % (count // 2)) + (at + at // 4) % 2
