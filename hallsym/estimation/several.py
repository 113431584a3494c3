"""Several logs of one device: shared parameters, each log with its own runs, noise and outliers.

Every log is checked, summarised and judged by itself (`Task`), with one centre for all, and only the optimum
is that of the sum of their costs (`joint_cost`). No sample is read more often than by a fit of one log.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

import numpy as np

from hallsym.errors import InputError, nearest
from hallsym.estimation import outliers, start
from hallsym.estimation.calibration import Errors, Fit
from hallsym.estimation.channel_assignment import Wiring
from hallsym.estimation.decoding import columns_of
from hallsym.estimation.identifiable import Determination, determine
from hallsym.estimation.joint_cost import JointCost, Sharing, joint_cost, numbered, run_numbers
from hallsym.estimation.lateness import lateness
from hallsym.estimation.likelihood import cost_of
from hallsym.estimation.linearised import exact
from hallsym.estimation.optimum import Solution, search
from hallsym.estimation.prepare import held_out, prepared
from hallsym.estimation.run_statistics import joined
from hallsym.estimation.same_device import check_gains, check_same, labels
from hallsym.estimation.several_result import Member, several_fit
from hallsym.estimation.task import ROUNDS, Begun, Progress, Started, Task
from hallsym.log import Log
from hallsym.log.batches import Weigh, remembered
from hallsym.log.phase import nearest_turn
from hallsym.model import Model


@dataclass(frozen=True, eq=False)
class Asked:
    """How a fit was asked for; see `fit`."""

    solver: str
    holdout: Sequence[int] | None
    loss: str
    resolve_wiring: bool
    drop_bad: bool
    seed: int
    start: np.ndarray | None
    say: Progress


@dataclass(eq=False)
class _Open:
    """A log that takes part: its task, its costs so far, what was taken out and what is to be said."""

    task: Task
    begun: Begun
    notes: tuple[str, ...]
    mounted: Wiring | None
    wiring: Wiring | None
    keep: Weigh | None = None
    rule: outliers.Filter | None = field(default=None, repr=False)
    suspects: Weigh | None = field(default=None, repr=False)


def fit_several(
    logs: Sequence[Log],
    holdout_logs: Sequence[Log],
    build: Callable[[Log], Model],
    per_log: Sequence[str],
    asked: Asked,
    began: float,
) -> Fit:
    """Return the fit of several logs; `build(log)`: the model of one. Other arguments as for `fit`."""
    if not logs:
        raise InputError("There is no log to fit; give one at least.")
    every = [*logs, *holdout_logs]
    models = [build(log) for log in every]
    check_same(every, models)
    model = models[0]
    if not exact(model):
        raise InputError(
            f"Model {model.name} with {', '.join(model.effects)} has no run statistics, so several "
            "logs cannot be fitted together with it; fit them without the effects, or one at a time."
        )
    names = labels(every)
    own = _own_parameters(model, per_log, len(logs), bool(holdout_logs))
    opened = _opened(every, model, len(logs), asked)
    check_gains(every, opened[0].task.model, [one.begun for one in opened])
    fitted, held = opened[: len(logs)], opened[len(logs) :]
    together = _Together(fitted, Sharing.of(model, own, names[: len(logs)]), asked)
    solution = together.optimum()
    members = [
        Member(names[g], one.task, together.of_log(solution, g), errors, one.keep, one.wiring, one.mounted,
               (*one.notes, *_late(one, together.of_log(solution, g))))
        for g, (one, errors) in enumerate(zip(fitted, together.errors(solution), strict=True))
    ]  # fmt: skip
    judged = [_judged(names[len(logs) + k], one, members[-1].solution) for k, one in enumerate(held)]
    return several_fit(together.sharing, solution, members, judged, together.numbers, began)


def _own_parameters(model: Model, per_log: Sequence[str], logs: int, holdout: bool) -> tuple[str, ...]:
    """Return the parameters that each log has of its own, by names and patterns."""
    found: list[str] = []
    for pattern in per_log:
        named = [name for name in model.names if fnmatchcase(name, pattern)]
        if not named:
            raise InputError(
                f"Model {model.name} has no parameter {pattern!r}{nearest(pattern, list(model.names))}; "
                f"each log can have its own of {', '.join(model.names)}."
            )
        found += [name for name in named if name not in found]
    if found and logs < 2:
        raise InputError("Parameters per log need two logs at least; give another log, or leave them out.")
    if found and holdout:
        raise InputError(
            f"A held-out log cannot have a {found[0]} of its own, since nothing of it is fitted; leave "
            "per-log parameters or held-out logs out, or hold out some runs of that log."
        )
    return tuple(found)


def _opened(logs: Sequence[Log], model: Model, fitted: int, asked: Asked) -> list[_Open]:
    """Return every log checked, summarised about the centre of the first, and judged."""
    out: list[_Open] = []
    centre: np.ndarray | None = None
    known = {run for log in logs[:fitted] for run in log.runs}
    if lost := [run for run in asked.holdout or () if run not in known]:
        raise InputError(f"Held-out run {lost[0]} is in none of the {fitted} logs.")
    for k, log in enumerate(logs):
        asked.say(f"checking {log.name}")
        ready = prepared(log, model, drop_bad=asked.drop_bad)
        held = log.meta.holdout if asked.holdout is None else tuple(asked.holdout)
        held = held_out(ready.log, [r for r in held if r in ready.log.runs]) if k < fitted else ()
        task = Task(ready.log, model, held, asked.solver, asked.loss, asked.seed, asked.say, None,
                    centre=centre)  # fmt: skip
        found = task.opened(asked.resolve_wiring)
        centre = found.begun.everything.summary.centre
        notes = (*ready.notes, *found.judged.notes)
        if found.judged.spiky:
            notes = (*notes, "Spikes bend the slopes by which units and signs are judged; look at the log.")
        out.append(_Open(found.task, found.begun, notes, ready.wiring, found.wiring))
    return out


class _Together:
    """The logs that are fitted, and their common optimum."""

    def __init__(self, logs: list[_Open], sharing: Sharing, asked: Asked) -> None:
        self.logs, self.sharing, self.asked = logs, sharing, asked
        self.numbers = run_numbers([one.begun.everything.summary.runs for one in logs])

    def optimum(self) -> Solution:
        """Return the optimum, without outliers, for the noise that each log shows."""
        state = self.solve(self.asked.solver)
        if loud := self._suspicious(state):
            state = self._without_outliers(state, loud)
        return self._with_noise_left(state)

    def solve(self, solver: str, begin_at: np.ndarray | None = None) -> Solution:
        """Minimise the sum of the costs as they are."""
        everything = self._sum(one.begun.everything for one in self.logs)
        fitted = self._sum(one.begun.fitted for one in self.logs)
        merged = joint_cost(
            self.sharing, [one.begun.merged for one in self.logs], [{0: g} for g in range(len(self.logs))]
        )
        model = self.sharing.joint
        first = np.clip(self._first() if begin_at is None else begin_at, *model.bounds)
        found: Determination = determine(fitted, first)
        held = list(found.held)
        first[held] = np.clip(model.nominal, *model.bounds)[held]
        self.asked.say(f"solving {len(self.logs)} logs with {solver}")
        best = search(fitted, merged, first, found, solver=solver, seed=self.asked.seed)
        best = replace(best, p=nearest_turn(model, best.p))
        return Solution(everything, fitted, found, best)

    def _sum(self, costs: Iterable) -> JointCost:
        return joint_cost(self.sharing, list(costs), self.numbers)

    def _first(self) -> np.ndarray:
        """Return where the search begins: the closed form of all runs, of own parameters that of each log."""
        if self.asked.start is not None:
            every = [np.asarray(self.asked.start, dtype=float)] * len(self.logs)
        else:
            parts = [numbered(one.begun.fitted.summary, known)
                     for one, known in zip(self.logs, self.numbers, strict=True)]  # fmt: skip
            pooled = cost_of(joined(parts).merged(), self.logs[0].task.noise.std)
            shared = start.closed_form(pooled, start.linear_fit(pooled))
            of_own = np.isin(self.sharing.model.names, self.sharing.own)
            every = [
                np.where(of_own, start.closed_form(one.begun.merged, one.begun.linear), shared)
                if of_own.any() else shared
                for one in self.logs
            ]  # fmt: skip
        first = np.zeros(len(self.sharing.joint.names))
        for chosen, values in zip(self.sharing.chosen, every, strict=True):
            first[chosen] = values
        return first

    def of_log(self, state: Solution, g: int) -> Solution:
        """Return the optimum as one log sees it: its runs, its parameters."""
        everything, fitted = state.everything.shares[g][0], state.fitted.shares[g][0]
        return Solution(
            everything, fitted, restricted(state.determination, self.sharing, g),
            replace(state.search, p=self.sharing.of_log(g, state.p)),
        )  # fmt: skip

    def errors(self, state: Solution) -> list[Errors]:
        """Return the error tables of every log."""
        return [one.task.errors(self.of_log(state, g), one.keep) for g, one in enumerate(self.logs)]

    def _suspicious(self, state: Solution) -> list[int]:
        """Return the logs in which outliers are looked for."""
        if self.asked.loss == "none":
            return []
        if self.asked.loss != "auto":
            return list(range(len(self.logs)))
        found = enumerate(self.errors(state))
        return [g for g, errors in found if self.logs[g].task.suspicious(self.of_log(state, g), errors)]

    def _without_outliers(self, state: Solution, loud: Sequence[int]) -> Solution:
        """Take outliers of the logs `loud` out and fit again, until the same samples are left."""
        whole, clean = state, [self.logs[g].begun for g in loud]
        total = sum(float(begun.everything.summary.counts.sum()) for begun in clean)
        weigh = {g: self._first_suspects(self.logs[g]) for g in loud}
        before = -1.0
        for _ in range(ROUNDS):
            for g in loud:
                self.logs[g].begun = self.logs[g].task.begin(self.logs[g].task.summary(weigh[g]))
            left = sum(float(self.logs[g].begun.everything.summary.counts.sum()) for g in loud)
            if left < total:
                state = self.solve("direct", state.p)
            if abs(left - before) <= 1e-6 * total:
                break
            before = left
            weigh = {g: self._weigh(state, g) for g in loud}
        if left == total:
            for g, begun in zip(loud, clean, strict=True):
                self.logs[g].begun = begun
            return whole
        for g, begun in zip(loud, clean, strict=True):
            one = self.logs[g]
            counts = (float(b.everything.summary.counts.sum()) for b in (begun, one.begun))
            all_of_it, some = counts
            one.keep = weigh[g]
            one.notes = (*one.notes, f"{all_of_it - some:.0f} of {all_of_it:.0f} samples are isolated spikes "
                         "and were left out of fit and error tables (--loss none keeps them).")  # fmt: skip
        return self.solve(self.asked.solver)

    def _first_suspects(self, one: _Open) -> Weigh:
        columns = (*one.task.model.references, *one.task.model.channels)
        one.suspects = remembered(outliers.column_spikes(columns), one.task.log.rows, columns)
        return one.suspects

    def _weigh(self, state: Solution, g: int) -> Weigh:
        one = self.logs[g]
        assert one.suspects is not None
        one.rule = one.task.weigh(self.of_log(state, g), one.suspects)
        return remembered(one.rule, one.task.log.rows, columns_of(one.task.model))

    def _with_noise_left(self, state: Solution) -> Solution:
        """Return the optimum with the noise that it leaves where that was estimated and is larger."""
        changed = False
        for g, one in enumerate(self.logs):
            noise = one.task.noise_left(self.of_log(state, g), one.keep)
            if noise is not None:
                one.task = replace(one.task, log=replace(one.task.log, noise=noise))
                one.begun = one.task.begin(one.begun.everything.summary)
                changed = True
        return self.solve("direct", state.p) if changed else state


def restricted(found: Determination, sharing: Sharing, g: int) -> Determination:
    """Return what is determined of the parameters of one log."""
    chosen, names = sharing.chosen[g], sharing.model.names
    place = {int(k): own for own, k in enumerate(chosen)}
    structural = [names[place[k]] for k, n in enumerate(sharing.joint.names)
                  if n in found.structural and k in place]  # fmt: skip
    held = tuple(place[k] for k in found.held if k in place)
    return replace(found, scale=found.scale[chosen], null=found.null[chosen], held=held,
                   structural=tuple(structural))  # fmt: skip


def _late(one: _Open, state: Solution) -> tuple[str, ...]:
    late = lateness(one.task.log, one.task.model, state.p, state.zeros(), state.fitted)
    if isinstance(state, Started):
        one.task.check(state)
    start.check_reference(one.task.model, one.begun.linear.unexplained, one.task.log.name)
    return () if late is None else (late,)


def _judged(name: str, one: _Open, known: Solution) -> Member:
    """Return a held-out log, decoded with the parameters of the others; all of its runs are held out."""
    everything = one.begun.everything
    state = Solution(everything, everything, known.determination, known.search)
    errors = replace(one.task.errors(state, None), holdout=everything.summary.runs)
    return Member(name, one.task, state, errors, None, one.wiring, one.mounted,
                  (*one.notes, *_late(one, state)), held_out=True)  # fmt: skip
