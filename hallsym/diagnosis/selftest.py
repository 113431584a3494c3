"""What a diagnosis of this log can find: known effects injected into its own motion, diagnosed blind.

The fitted model is the simulated machine, the recorded motion its motion, and the noise is that of the log as
it is: its size whatever was stated, its colour, in the reference too. Each effect of the catalogue and each
fault of samples is injected at sizes whose noise-free gap is a given multiple of the noise floor, beside an
imperfection that the model does not hold and that is too small to report. Each simulated log is diagnosed as
the real one would be, many times.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.diagnosis.detection import FOUND, REPEATS, CurvePoint, curve_point
from hallsym.diagnosis.engine import diagnose, prepare
from hallsym.diagnosis.injection import Injection, Sized, generator, injections, sized
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.simulated_machine import decimated, machine_of, simulated_noise
from hallsym.diagnosis.verdict import QUIET
from hallsym.errors import InputError, nearest
from hallsym.estimation.calibration import Fit
from hallsym.families.faults import FAULTS
from hallsym.log import Log
from hallsym.model import Effect, Model

NO_EFFECT = "no effect"
"""Name of a trial without an injection."""


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
    imperfection: str = ""


IMPERFECT = 0.15
"""Gap of the imperfection of a simulated machine, over the noise floor.

It raises the gap metric by 1.1 %, a quarter of what is worth reporting: no machine is exactly its model."""


class Bench:
    """What all trials share: the simulated machine, its noise, and how a simulated log is diagnosed.

    `reasons`: effect -> why it cannot be injected; `forms`: effect -> the form in which it is.
    """

    def __init__(self, setup: Setup, own: tuple[Effect, ...], seed: int, rows: int) -> None:
        self.setup, self.own, self.seed = setup, own, seed
        setup.say("decimating the log")
        base = replace(setup.base, timed=True)
        log, self.decimation = decimated(base, rows)
        base = replace(base, log=log, keep=None)
        setup.say("modelling the noise")
        stated = frozenset(c for c, known in setup.fit.noise.sigmas.items() if known.source == "given")
        self.noise = simulated_noise(base, setup.runs, setup.floor.stated)
        smooth = replace(base, timed=setup.base.timed)
        self.truth = machine_of(smooth, setup.floor.metric * self.noise.ratio, stated)
        self._imperfections: dict[int, list[tuple[str, np.ndarray]]] = {}
        self.reasons: dict[str, str] = {}
        self.forms: dict[str, str] = {}

    def injections(self, repeat: int) -> list[Injection]:
        """Return what can be injected, drawn anew for each repeat."""
        found, reasons = injections(
            self.truth, self.setup.catalogue, lambda name: generator(self.seed, "draw", name, repeat)
        )
        self.reasons |= reasons
        self.forms = {i.name: i.form for i in found}
        return found

    def imperfection(self, repeat: int, beside: str) -> tuple[str, np.ndarray | float]:
        """Return a small effect of the catalogue other than `beside`, and what it does to the readings."""
        if repeat not in self._imperfections:
            rng = generator(self.seed, "imperfection", repeat)
            every = [i for i in self.injections(repeat) if i.sized and i.name not in FAULTS]
            found: list[tuple[str, np.ndarray]] = []
            for k in rng.permutation(len(every)):
                size = sized(self.truth, every[k], float(np.hypot(1.0, IMPERFECT)), anywhere=True)
                if not size.reason:
                    found.append((every[k].name, every[k].make(size.amount, 0.0) - self.truth.clean))
                if len(found) == 2:  # one of them is another than the effect that is injected
                    break
            self._imperfections[repeat] = found
        return next(((n, v) for n, v in self._imperfections[repeat] if n != beside), ("", 0.0))

    def trial(self, injection: Injection | None, ratio: float, repeat: int) -> Trial | str:
        """Inject, diagnose blind and return the trial; the reason where nothing can be injected."""
        began, truth = perf_counter(), self.truth
        name, scaled = (injection.name, injection.sized) if injection else (NO_EFFECT, False)
        size = sized(truth, injection, ratio) if injection and scaled else Sized(1.0, 0.0)
        if size.reason:
            return size.reason
        beside, small = self.imperfection(repeat, name)
        rng = generator(self.seed, "noise", name, str(ratio), repeat)
        noise, reference = self.noise.draw(truth.columns["run"], rng)
        noise = noise + small
        readings = injection.make(size.amount, noise) if injection else truth.clean + noise
        outcome, verdict, named = self.diagnosed(truth.log(readings, reference), name)
        return Trial(
            name=name,
            ratio=ratio if scaled else None,
            repeat=repeat,
            gap_m=size.gap_m,
            size=injection.size(size.amount) if injection else {},
            outcome=outcome,
            verdict=verdict,
            named=named,
            seconds=perf_counter() - began,
            imperfection=beside,
        )

    def diagnosed(self, log: Log, name: str) -> tuple[str, str, tuple[str, ...]]:
        """Diagnose a simulated log; return outcome, verdict and names."""
        setup = self.setup
        try:
            found = diagnose(
                log, setup.fit.model, holdout=setup.holdout, effects=self.own, threshold=setup.threshold
            )
        except InputError:
            return "refused", "refused", ()
        outcome, named = _outcome(found, name)
        return outcome, found.verdict, named


def _outcome(found: Diagnosis, name: str) -> tuple[str, tuple[str, ...]]:
    """Return the outcome, and the names that were given: those of the first group, or the first."""
    ranked = found.ranked
    if found.verdict in QUIET:
        return "no gap", ()
    if not ranked or not found.effects:
        return "unexplained", ()
    group = next((g for g in found.groups if ranked[0] in g), (ranked[0],))
    if ranked[0] == name:
        return "found", group
    if name in group:
        return "group", group
    return ("listed" if name in [e.name for e in found.effects] else "other"), group


def run_trials(
    bench: Bench, wanted: Sequence[str], ratios: Sequence[float], repeats: int
) -> tuple[list[Trial], bool]:
    """Run all trials, those without an effect first; return them, and whether no interrupt ended them."""
    out: list[Trial] = []
    say, quiet = bench.setup.say, len(ratios) * repeats
    try:
        for k in range(quiet):
            say(f"{NO_EFFECT}, trial {k + 1} of {quiet}")
            made = bench.trial(None, ratios[k % len(ratios)], k // len(ratios))
            out += [made] if isinstance(made, Trial) else []
        began = perf_counter()
        for repeat in range(repeats):
            queue = [i for i in bench.injections(repeat) if i.name in wanted]
            for k, injection in enumerate(queue):
                left = _left(perf_counter() - began, repeat * len(queue) + k, repeats * len(queue))
                for ratio in ratios if injection.sized else ratios[:1]:
                    say(f"{injection.name} at {ratio:g} x the noise floor{left}")
                    made = bench.trial(injection, ratio, repeat)
                    if isinstance(made, str):
                        bench.reasons.setdefault(injection.name, made)
                        break
                    out.append(made)
    except KeyboardInterrupt:
        return out, False
    return out, True


def first_look(
    bench: Bench, wanted: Sequence[str], ratios: Sequence[float], seconds: float
) -> tuple[list[Trial], bool, str]:
    """Run one trial of each size, the largest of every effect first, as many as `seconds` allow.

    No trial begins that would end later if it took as long as the longest one so far. Returned are the
    trials, whether no interrupt ended them, and a note on what was not reached ("" if all were).
    """
    say, began, longest = bench.setup.say, perf_counter(), 0.0
    out: list[Trial] = []
    queue = [i for i in bench.injections(0) if i.name in wanted]
    largest = [(i, ratios[-1] if i.sized else ratios[0]) for i in queue]
    smaller = [(i, r) for r in reversed(ratios[:-1]) for i in (*queue, None) if i is None or i.sized]
    plan: list[tuple[Injection | None, float]] = [(None, ratios[-1]), *largest, *smaller]
    note = ""
    try:
        for k, (injection, ratio) in enumerate(plan):
            left = seconds - (perf_counter() - began)
            if out and longest > left:
                note = (
                    f"A first look: {k} of {len(plan)} trials fitted into the time, the largest size of each "
                    "effect first. Without --quick all are made, or name a few with --effects."
                )
                break
            name = injection.name if injection else NO_EFFECT
            say(f"{name} at {ratio:g} x the noise floor, {k} of {len(plan)} trials done, {left:.0f} s left")
            made = bench.trial(injection, ratio, 0)
            if isinstance(made, str):
                bench.reasons.setdefault(name, made)
                continue
            out.append(made)
            longest = max(longest, made.seconds)
    except KeyboardInterrupt:
        return out, False, note
    finally:
        out.sort(key=lambda t: t.ratio or 0.0)
    return out, True, note


def _left(seconds: float, done: int, total: int) -> str:
    if not done:
        return ""
    minutes = seconds / done * (total - done) / 60
    return f", {done} of {total} effects done, about {minutes:.1f} min left"


RATIOS = (1.07, 1.3, 2.0)
"""Gap over noise floor of the sizes that are tried: at the threshold, clear, dominant."""
ROWS = 8000
"""Samples to which a log is decimated if it still shows the same."""
HITS = ("found", "group")
"""Outcomes of a trial in which the injected effect was found."""


@dataclass(frozen=True)
class Findable:
    """The result of the trials of one effect.

    `status`: "found" (from `ratio` on, in 90 % of the trials), "not found", "not testable" (`reason` says
    why) or "not run". `gap_m` and `size` are those of `ratio`; `confused_with`: named beside or instead of
    it. `curve`: how often it was found at each size.
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
    curve: tuple[CurvePoint, ...] = ()
    trials: tuple[Trial, ...] = ()


@dataclass(frozen=True)
class SelfTest:
    """The answer of `selftest`. `complete` is False when it was interrupted: `effects` hold what was done.

    `outputs`: names of the pose. `false_alarm_rate`: `found` is the share of logs without an effect in which
    the diagnosis said that there is a gap. Gaps are in m, or in rad where the pose is an angle alone.
    """

    effects: tuple[Findable, ...]
    false_alarms: int
    false_alarm_rate: CurvePoint
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
    repeats: int = REPEATS,
    seed: int = 0,
    rows: int = ROWS,
    seconds: float | None = None,
    drop_bad: bool = False,
    on_progress: Callable[[str], None] | None = None,
) -> SelfTest:
    """Return which effects a diagnosis of `log` would find, and from which size on.

    `names`: effects and faults to try (default: all). `ratios`: gap over noise floor of the sizes, above 1.
    `repeats`: trials of each size, with other signs, instants and noise. `rows`: samples to decimate the log
    to. `seconds`: a first look that takes about so long, one trial of each size, the largest of each effect
    first; a note says what was not reached. `model`, `holdout`, `effects`, `threshold` as in `diagnose`. A
    keyboard interrupt ends it early: what was done is returned with `complete` False.

    Raises `InputError` for an unknown name, a ratio not above 1, and wherever `diagnose` does.
    """
    began = perf_counter()
    ratios = _ratios(ratios)
    for name, value in (("repeats", repeats), ("rows", rows)):
        if value < 1:
            raise InputError(f"Input {name} of the self-test must be 1 or more; instead received {value}.")
    setup = prepare(
        log, model, holdout=holdout, effects=effects, threshold=threshold, drop_bad=drop_bad,
        on_progress=on_progress,
    )  # fmt: skip
    wanted = _wanted(names, setup.catalogue)
    bench = Bench(setup, tuple(effects), seed, rows)
    note = ""
    if seconds is None:
        trials, complete = run_trials(bench, wanted, ratios, repeats)
    else:
        repeats, left = 1, seconds - (perf_counter() - began)
        trials, complete, note = first_look(bench, wanted, ratios, left)
    quiet = tuple(t for t in trials if t.name == NO_EFFECT)
    alarms = sum(t.verdict not in QUIET for t in quiet)
    return SelfTest(
        effects=tuple(_findable(bench, name, trials) for name in wanted),
        false_alarms=alarms,
        false_alarm_rate=curve_point(None, alarms, alarms, len(quiet)),
        quiet_trials=quiet,
        floor_m=bench.truth.floor_m,
        threshold=setup.threshold,
        ratios=ratios,
        repeats=repeats,
        seed=seed,
        noise={
            "text": bench.noise.text,
            "order": len(bench.noise.coefficients),
            "correlation_lag_one": bench.noise.correlation,
            "over_noise_floor": bench.noise.ratio,
        },
        thinning=bench.decimation,
        rows=bench.truth.clean.shape[1],
        model=setup.fit.model.name,
        outputs=setup.fit.model.pose,
        log={**setup.fit.log, "holdout": list(setup.holdout)},
        complete=complete,
        notes=tuple(dict.fromkeys((*([note] if note else []), NOT_TESTED, *setup.fit.notes))),
        seconds=perf_counter() - began,
    )


NOT_TESTED = (
    "The fitted model, with an imperfection too small to report, is the simulated machine and the recorded "
    "motion its motion: a gap that this log has is not part of the test."
)


def _wanted(names: Sequence[str] | None, catalogue: Sequence[Effect]) -> tuple[str, ...]:
    known = list(dict.fromkeys((*(e.name for e in catalogue), *FAULTS)))
    if names is None:
        return tuple(known)
    if not names:
        raise InputError("Effects to test must be at least one name; none was given.")
    for name in names:
        if name not in known:
            raise InputError(
                f"Effect to test must be one of {', '.join(known)}; instead received {name!r}"
                f"{nearest(name, known)}."
            )
    return tuple(dict.fromkeys(names))


def _ratios(ratios: Sequence[float]) -> tuple[float, ...]:
    if not ratios or not all(1 < r < np.inf for r in ratios):
        raise InputError(
            "Sizes of the self-test must be gaps over the noise floor, each a number above 1; instead "
            f"received {', '.join(f'{r:g}' for r in ratios) or 'none'}."
        )
    return tuple(sorted(set(ratios)))


def _findable(bench: Bench, name: str, trials: Sequence[Trial]) -> Findable:
    """Return the result of one effect: found from the smallest size on above which most trials find it."""
    effect = next((e for e in bench.setup.catalogue if e.name == name), None)
    own = tuple(t for t in trials if t.name == name)
    reason = bench.reasons.get(name, "")
    row = Findable(
        name,
        (effect or FAULTS[name]).link,
        "not found" if own else "not testable" if reason else "not run",
        reason,
        bench.forms.get(name, ""),
        confused_with=tuple(dict.fromkeys(n for t in own for n in t.named if n != name)),
        trials=own,
    )
    curve: list[CurvePoint] = []
    for ratio in dict.fromkeys(t.ratio for t in own):
        at = [t for t in own if t.ratio == ratio]
        found, noticed = sum(t.outcome in HITS for t in at), sum(t.verdict not in QUIET for t in at)
        curve.append(curve_point(ratio, found, noticed, len(at)))
    least: CurvePoint | None = None
    for point in reversed(curve):
        if point.found < FOUND:
            break
        least = point
    row = replace(row, curve=tuple(curve))
    if least is None:
        return row
    first = next(t for t in own if t.ratio == least.ratio)
    return replace(row, status="found", ratio=least.ratio, gap_m=first.gap_m, size=first.size)
