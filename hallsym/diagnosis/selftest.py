"""What a diagnosis of this log can find: known effects injected into its own motion, diagnosed blind.

The fitted model is the machine, the recorded motion is the truth, the noise looks like the residuals. Each
effect of the catalogue and each fault of samples is given sizes whose noise-free gap is so many times the
noise floor, and the simulated log is diagnosed as the real one would be.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.diagnosis import engine
from hallsym.diagnosis.decimation import decimated
from hallsym.diagnosis.effect import Effect
from hallsym.diagnosis.engine import diagnose
from hallsym.diagnosis.injection import Injection, Sized, generator, injections, sized
from hallsym.diagnosis.noise_model import ResidualNoise, residual_noise
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.search import base_of, facts_of, floor_of
from hallsym.diagnosis.simulated_machine import SimulatedMachine, machine_of
from hallsym.diagnosis.survey import survey
from hallsym.errors import InputError, nearest
from hallsym.estimation.calibration import Fit
from hallsym.families.faults import FAULTS
from hallsym.log import Log
from hallsym.model import Model

RATIOS = (1.07, 1.3, 2.0)
"""Gap over noise floor of the sizes that are tried: at the threshold, clear, dominant."""
ROWS = 8000
"""Samples to which a log is thinned if it still shows the same."""
NONE = "no effect"
HITS = ("found", "group")


@dataclass(frozen=True)
class Trial:
    """One injection and what the blind diagnosis said.

    `ratio`: gap over noise floor that was asked for, None where nothing can be scaled; `gap_m`: noise-free
    gap metric that was reached. `size`: parameter -> (value in SI, unit). `outcome`: "found" (named first),
    "group" (in one group with the first), "listed" (named, not first), "other", "unexplained", "no gap", or
    "refused" (the diagnosis would not take the log).
    """

    name: str
    ratio: float | None
    repeat: int
    gap_m: float
    size: dict[str, tuple[float, str]]
    outcome: str
    verdict: str
    named: tuple[str, ...]
    seconds: float


@dataclass(frozen=True)
class Findable:
    """What the trials say of one effect.

    `status`: "found" (from `ratio` on, in every trial), "not found", "not testable" (`reason` says why) or
    "not run". `gap_m` and `size` are those of `ratio`; `confused_with`: named beside or instead of it.
    """

    name: str
    link: str
    status: str
    reason: str = ""
    form: str = ""
    ratio: float | None = None
    gap_m: float | None = None
    size: dict[str, tuple[float, str]] = field(default_factory=dict)
    confused_with: tuple[str, ...] = ()
    trials: tuple[Trial, ...] = ()


@dataclass(frozen=True)
class SelfTest:
    """The answer of `selftest`. `complete` is False when it was interrupted: `effects` hold what was done.

    `outputs`: names of the pose. Gaps are in m, or in rad where the pose is an angle alone.
    """

    effects: tuple[Findable, ...]
    false_alarms: int
    quiet_trials: tuple[Trial, ...]
    floor_m: float
    threshold: float
    ratios: tuple[float, ...]
    repeats: int
    seed: int
    noise: dict[str, Any]
    thinning: str
    rows: int
    model: str
    outputs: tuple[str, ...]
    log: dict[str, Any]
    complete: bool
    notes: tuple[str, ...]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain JSON data."""
        return asdict(self)

    def effect(self, name: str) -> Findable:
        """Return the row of one effect."""
        known = [e.name for e in self.effects]
        if name not in known:
            raise InputError(f"The self-test has no effect {name!r}{nearest(name, known)}.")
        return self.effects[known.index(name)]


def selftest(
    log: Log,
    model: str | Model | Fit | None = None,
    *,
    names: Sequence[str] | None = None,
    holdout: Sequence[int] | None = None,
    effects: Sequence[Effect] = (),
    threshold: float | None = None,
    ratios: Sequence[float] = RATIOS,
    repeats: int = 1,
    seed: int = 0,
    rows: int = ROWS,
    drop_bad: bool = False,
    on_progress: Callable[[str], None] | None = None,
) -> SelfTest:
    """Say which effects a diagnosis of `log` would find, and from which size on.

    `names`: effects and faults to try (default: all). `ratios`: gap over noise floor of the sizes, above 1.
    `repeats`: trials of each size, with other signs, instants and noise. `rows`: samples to thin the log to.
    `model`, `holdout`, `effects`, `threshold` as in `diagnose`. A keyboard interrupt ends it early: what was
    done is returned with `complete` False.

    Raises `InputError` for an unknown name, a ratio not above 1, and wherever `diagnose` does.
    """
    began, say = perf_counter(), on_progress or (lambda _: None)
    model = engine._built(log, model)
    catalogue = (*model.family.catalogue, *effects)
    wanted = _wanted(names, catalogue)
    ratios = _ratios(ratios)
    if repeats < 1:
        raise InputError(f"Input repeats of the self-test must be 1 or more; instead received {repeats}.")
    if rows < 1:
        raise InputError(f"Input rows of the self-test must be 1 or more; instead received {rows}.")
    log, pieces = engine._pieces(log, model) if holdout is None else (log, None)
    apart, level = pieces or engine._holdout(log, holdout), engine._threshold(log, threshold)
    say("fitting the model")
    log, result = engine._fitted(log, model, apart, drop_bad, say)
    bench = _Bench(log, result, apart, level, tuple(effects), catalogue, seed, rows, say)
    trials, complete = _run(bench, wanted, ratios, repeats)
    quiet = tuple(t for t in trials if t.name == NONE)
    return SelfTest(
        effects=tuple(_findable(bench, name, trials, ratios, repeats) for name in wanted if name != NONE),
        false_alarms=sum(t.verdict != "no gap" for t in quiet),
        quiet_trials=quiet,
        floor_m=bench.truth.floor_m,
        threshold=level,
        ratios=ratios,
        repeats=repeats,
        seed=seed,
        noise={
            "text": bench.noise.text,
            "order": len(bench.noise.coefficients),
            "correlation_lag_one": bench.noise.lag_one,
            "residual_variance_over_stated": bench.noise.excess,
        },
        thinning=bench.thinning,
        rows=bench.truth.clean.shape[1],
        model=result.model.name,
        outputs=result.model.pose,
        log={**result.log, "holdout": list(apart)},
        complete=complete,
        notes=tuple(dict.fromkeys((*bench.notes, *result.notes))),
        seconds=perf_counter() - began,
    )


def _wanted(names: Sequence[str] | None, catalogue: Sequence[Effect]) -> tuple[str, ...]:
    known = [NONE, *dict.fromkeys(e.name for e in catalogue), *FAULTS]
    if names is None:
        return tuple(known)
    if not names:
        raise InputError("Effects to test must be at least one name; none was given.")
    for name in names:
        if name not in known[1:]:
            raise InputError(
                f"Effect to test must be one of {', '.join(known[1:])}; instead received {name!r}"
                f"{nearest(name, known[1:])}."
            )
    return (NONE, *dict.fromkeys(names))


def _ratios(ratios: Sequence[float]) -> tuple[float, ...]:
    if not ratios or not all(1 < r < np.inf for r in ratios):
        raise InputError(
            "Sizes of the self-test must be gaps over the noise floor, each a number above 1; instead "
            f"received {', '.join(f'{r:g}' for r in ratios) or 'none'}."
        )
    return tuple(sorted(set(ratios)))


# -- the trials --------------------------------------------------------------------------------------------


class _Bench:
    """What all trials share: the machine, its noise, and how a simulated log is diagnosed."""

    def __init__(
        self,
        log: Log,
        result: Fit,
        apart: tuple[int, ...],
        level: float,
        own: tuple[Effect, ...],
        catalogue: tuple[Effect, ...],
        seed: int,
        rows: int,
        say: Callable[[str], None],
    ) -> None:
        self.model, self.apart, self.level, self.own = result.model, apart, level, own
        self.catalogue, self.seed, self.say = catalogue, seed, say
        base = base_of(log, result)
        base = replace(base, model=base.model.family.direct(base.model))
        say("thinning the log")
        short = decimated(base, rows)
        base = replace(base, log=short.log, keep=None)
        self.truth: SimulatedMachine = machine_of(base, floor_of(result, base.pose_weights).metric)
        self.thinning = short.text
        say("learning the noise")
        facts = facts_of(base, survey(base, frozenset(self.truth.runs)))
        self.noise: ResidualNoise = residual_noise(base, catalogue, facts)
        self.reasons: dict[str, str] = {}
        self.forms: dict[str, str] = {}
        self.notes = [
            "The fitted model is the machine and the recorded motion is the truth: a gap that this log has "
            "is not part of the test."
        ]

    def injections(self, repeat: int) -> list[Injection]:
        """Return what can be injected, drawn anew for each repeat."""
        found, reasons = injections(
            self.truth, self.catalogue, lambda name: generator(self.seed, "draw", name, repeat)
        )
        self.reasons |= reasons
        self.forms = {i.name: i.form for i in found}
        return found

    def trial(self, injection: Injection | None, ratio: float | None, repeat: int) -> Trial | str:
        """Inject, diagnose blind, and say what came out; the reason where nothing can be injected."""
        began, truth = perf_counter(), self.truth
        name = injection.name if injection else NONE
        size = sized(truth, injection, ratio) if injection and injection.sized and ratio else Sized(1.0, 0.0)
        if size.reason:
            return size.reason
        noise = self.noise.draw(truth.columns["run"], generator(self.seed, "noise", name, str(ratio), repeat))
        readings = injection.make(size.amount, noise) if injection else truth.clean + noise
        outcome, verdict, named = self.diagnosed(truth.log(readings), name)
        return Trial(
            name, ratio if injection and injection.sized else None, repeat, size.gap_m,
            injection.size(size.amount) if injection else {}, outcome, verdict, named,
            perf_counter() - began,
        )  # fmt: skip

    def diagnosed(self, log: Log, name: str) -> tuple[str, str, tuple[str, ...]]:
        """Diagnose a simulated log; returns outcome, verdict and names."""
        try:
            found = diagnose(log, self.model, holdout=self.apart, effects=self.own, threshold=self.level)
        except InputError:
            return "refused", "refused", ()
        outcome, named = _outcome(found, name)
        return outcome, found.verdict, named


def _outcome(found: Diagnosis, name: str) -> tuple[str, tuple[str, ...]]:
    """Outcome, and the names that were given: those of the first group, or the first."""
    ranked = found.ranked
    if found.verdict == "no gap":
        return "no gap", ()
    if not ranked or not found.effects:
        return "unexplained", ()
    group = next((tuple(g) for g in found.groups if ranked[0] in g), (ranked[0],))
    if ranked[0] == name:
        return "found", group
    if name in group:
        return "group", group
    return ("listed" if name in [e.name for e in found.effects] else "other"), group


def _run(
    bench: _Bench, wanted: Sequence[str], ratios: Sequence[float], repeats: int
) -> tuple[list[Trial], bool]:
    """Run all trials; an interrupt ends it, with what was done."""
    out: list[Trial] = []
    quiet = [(None, r, k) for k in range(repeats) for r in ratios]
    try:
        for injection, ratio, repeat in quiet:
            bench.say(f"{NONE}, trial {len(out) + 1} of {len(quiet)}")
            made = bench.trial(injection, ratio, repeat)
            out += [made] if isinstance(made, Trial) else []
        began = perf_counter()
        for repeat in range(repeats):
            queue = [i for i in bench.injections(repeat) if i.name in wanted]
            for k, injection in enumerate(queue):
                left = _left(perf_counter() - began, repeat * len(queue) + k, repeats * len(queue))
                for ratio in ratios if injection.sized else ratios[:1]:
                    bench.say(f"{injection.name} at {ratio:g} x the noise floor{left}")
                    made = bench.trial(injection, ratio, repeat)
                    if isinstance(made, Trial):
                        out.append(made)
                    else:
                        bench.reasons.setdefault(injection.name, made)
                        break
    except KeyboardInterrupt:
        return out, False
    return out, True


def _left(seconds: float, done: int, total: int) -> str:
    if not done:
        return ""
    minutes = seconds / done * (total - done) / 60
    return f", {done} of {total} effects done, about {minutes:.1f} min left"


def _findable(
    bench: _Bench, name: str, trials: Sequence[Trial], ratios: Sequence[float], repeats: int
) -> Findable:
    effect = next((e for e in bench.catalogue if e.name == name), None)
    link = (effect or FAULTS[name]).link
    own = tuple(t for t in trials if t.name == name)
    form = bench.forms.get(name, "")
    if not own:
        reason = bench.reasons.get(name, "")
        return Findable(name, link, "not testable" if reason else "not run", reason, form)
    others = tuple(dict.fromkeys(n for t in own for n in t.named if n != name))
    asked = list(dict.fromkeys(t.ratio for t in own))
    good: list[float | None] = []
    for ratio in reversed(asked):
        if not all(t.outcome in HITS for t in own if t.ratio == ratio):
            break
        good.append(ratio)
    reason = bench.reasons.get(name, "")
    if not good:
        return Findable(name, link, "not found", reason, form, confused_with=others, trials=own)
    least = next(t for t in own if t.ratio == good[-1])
    return Findable(name, link, "found", reason, form, good[-1], least.gap_m, least.size, others, own)
