"""What a diagnosis of this log can find: known effects injected into its own motion, diagnosed blind.

The fitted model is the simulated machine, the recorded motion its motion, and the noise is that of the log as
it is: its size whatever was stated, its colour, in the reference too. Each effect of the catalogue and each
fault of samples is injected at sizes whose noise-free gap is a given multiple of the noise floor, beside an
imperfection that the model does not hold and that is too small to report. Each simulated log is diagnosed as
the real one would be, many times.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import takewhile
from time import perf_counter

import numpy as np

from hallsym.diagnosis.detection import Findable, SelfTest, Trial, curve_point
from hallsym.diagnosis.engine import diagnose, prepare
from hallsym.diagnosis.injection import Injection, generator, injections, sized
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.setup import Setup, decimated
from hallsym.diagnosis.simulated_machine import machine_of, simulated_noise
from hallsym.diagnosis.validation import QUIET
from hallsym.errors import InputError, nearest
from hallsym.estimation.calibration import Fit
from hallsym.families.faults import FAULTS
from hallsym.log import Log
from hallsym.model import Effect, Model

NO_EFFECT = "no effect"
"""Name of a trial without an injection."""
RATIOS = (1.07, 1.3, 2.0)
"""Gap over noise floor of the sizes that are tried: at the threshold, clear, dominant."""
REPEATS = 20
"""Trials of each size: if all find it, it is found in at least 83 % (two-sided 95 %)."""
ROWS = 30_000
"""Samples to which a longer log is decimated: the fifth that judges knows a gap metric to 1 %."""


class Bench:
    """What all trials share: the simulated machine, its noise, and how a simulated log is diagnosed.

    `reasons`: effect -> why it cannot be injected. `injections(repeat)`: what can be, by name, drawn anew for
    each repeat.
    """

    def __init__(self, setup: Setup, own: tuple[Effect, ...], seed: int, rows: int) -> None:
        self.setup, self.own, self.seed = setup, own, seed
        setup.say("decimating the log")
        log, self.decimation = decimated(setup.base, rows)
        base = replace(setup.base, log=log, keep=None)
        setup.say("modelling the noise")
        stated = frozenset(c for c, known in setup.fit.noise.sigmas.items() if known.source == "given")
        self.noise = simulated_noise(base, setup.runs, setup.floor.stated)
        self.truth = machine_of(base, setup.floor.metric * self.noise.ratio, stated)
        self.reasons: dict[str, str] = {}
        self.injections = lru_cache(1)(self._injections)
        self.imperfections = lru_cache(1)(self._imperfections)

    def _injections(self, repeat: int) -> dict[str, Injection]:
        clean = self.truth.recording.clean
        nothing = Injection("", lambda _, noise: clean + noise, lambda _: {}, sized=False)
        made, reasons = injections(
            self.truth, self.setup.catalogue, lambda name: generator(self.seed, "draw", name, repeat)
        )
        self.reasons |= reasons
        return {NO_EFFECT: nothing, **made}

    def _imperfections(self, repeat: int) -> list[tuple[str, np.ndarray]]:
        """Return two effects, each too small for a smaller finding, and what they add to the readings."""
        made, policy, found = self.injections(repeat), self.setup.policy, list[tuple[str, np.ndarray]]()
        known = [n for n, i in made.items() if i.sized and n not in FAULTS]
        for name in generator(self.seed, "imperfection", repeat).permutation(known).tolist():
            size = sized(self.truth, made[name], 1 + policy.minor * self.setup.threshold, anywhere=True)
            if not isinstance(size, str):
                found.append((name, made[name].make(size[0], 0.0) - self.truth.recording.clean))
            if len(found) == 2:  # one of them is another than the effect that is injected
                break
        return found

    def trial(self, name: str, ratio: float, repeat: int) -> Trial | None:
        """Inject an effect, diagnose blind and return the trial; None, with a reason, where it cannot be."""
        began, truth, injection = perf_counter(), self.truth, self.injections(repeat).get(name)
        if injection is None:
            return None
        beside, small = next((i for i in self.imperfections(repeat) if i[0] != name), ("", 0.0))
        size = sized(truth, injection, ratio, small) if injection.sized else (1.0, 0.0)
        if isinstance(size, str):
            self.reasons.setdefault(name, size)
            return None
        amount, gap_m = size
        rng = generator(self.seed, "noise", name, str(ratio), repeat)
        noise, reference = self.noise.draw(truth.recording.run, rng)
        outcome, verdict, named = self.diagnosed(
            truth.log(injection.make(amount, noise + small), reference), name
        )
        return Trial(
            name=name,
            ratio=ratio if injection.sized else None,
            repeat=repeat,
            gap_m=gap_m,
            size=injection.size(amount),
            imperfection=beside,
            outcome=outcome,
            verdict=verdict,
            named=named,
            seconds=perf_counter() - began,
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


def _run(
    bench: Bench, wanted: Sequence[str], ratios: Sequence[float], repeats: int, seconds: float
) -> tuple[list[Trial], bool, str]:
    """Run the trials of each repeat, the largest size of every effect first, as many as `seconds` allow.

    No trial begins that would end later if it took as long as the longest one so far. Returned are the
    trials, whether no interrupt ended them, and a note on what was not reached ("" if all were).
    """
    made = bench.injections(0)
    names = [n for n in made if n in (NO_EFFECT, *wanted)]
    each = {n: ratios if made[n].sized or n == NO_EFFECT else ratios[-1:] for n in names}
    plan = [(n, r, k) for k in range(repeats) for r in reversed(ratios) for n in names if r in each[n]]
    out: list[Trial] = []
    began, longest, left = perf_counter(), 0.0, ""
    try:
        for k, (name, ratio, repeat) in enumerate(plan):
            spent = perf_counter() - began
            if out and spent + longest > seconds:
                return out, True, (
                    f"A first look: {k} of {len(plan)} trials fitted into the time, the largest size of each "
                    "effect first. Without --quick all are made, or name a few with --effects."
                )  # fmt: skip
            if k:
                minutes = min(spent / k * (len(plan) - k), seconds - spent) / 60
                left = f", {k} of {len(plan)} trials done, about {minutes:.1f} min left"
            bench.setup.say(f"{name} at {ratio:g} x the noise floor{left}")
            trial = bench.trial(name, ratio, repeat)
            if trial:
                out.append(trial)
                longest = max(longest, trial.seconds)
    except KeyboardInterrupt:
        return out, False, ""
    return out, True, ""


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
    repeats = repeats if seconds is None else 1
    trials, complete, note = _run(bench, wanted, ratios, repeats, np.inf if seconds is None else seconds)
    quiet = tuple(t for t in trials if t.name == NO_EFFECT)
    alarms = [t.noticed for t in quiet]
    not_tested = (
        "The fitted model, with an imperfection too small to report, is the simulated machine and the "
        "recorded motion its motion: a gap that this log has is not part of the test."
    )
    return SelfTest(
        effects=tuple(_findable(bench, name, [t for t in trials if t.name == name]) for name in wanted),
        false_alarms=sum(alarms),
        false_alarm_rate=curve_point(None, alarms, alarms),
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
        rows=bench.truth.base.log.rows,
        model=setup.fit.model.name,
        outputs=setup.fit.model.pose,
        log={**setup.fit.log, "holdout": list(setup.holdout)},
        complete=complete,
        notes=tuple(dict.fromkeys((*([note] if note else []), not_tested, *setup.fit.notes))),
        seconds=perf_counter() - began,
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
    setup, reason, injection = bench.setup, bench.reasons.get(name, ""), bench.injections(0).get(name)
    effect = next((e for e in setup.catalogue if e.name == name), None)
    own = sorted(trials, key=lambda t: (t.ratio or 0.0, t.repeat))
    by_size = {ratio: [t for t in own if t.ratio == ratio] for ratio in dict.fromkeys(t.ratio for t in own)}
    curve = [curve_point(r, [t.found for t in at], [t.noticed for t in at]) for r, at in by_size.items()]
    enough = list(takewhile(lambda p: 1 - p.found <= setup.policy.minor, reversed(curve)))
    least = by_size[enough[-1].ratio][0] if enough else None
    return Findable(
        name=name,
        link=(effect or FAULTS[name]).link,
        status="found" if least else "not found" if own else "not testable" if reason else "not run",
        reason=reason,
        form=injection.form if injection else "",
        ratio=least.ratio if least else None,
        gap_m=least.gap_m if least else None,
        size=least.size if least else {},
        confused_with=tuple(dict.fromkeys(n for t in own for n in t.named if n != name)),
        curve=tuple(curve),
        trials=tuple(own),
    )
