"""Detection power on one log: known effects injected into its own motion, diagnosed blind.

The fitted model is the simulated machine, with the recorded motion and the actual noise of the log: its size,
whatever was stated, and its autocorrelation, in the reference too. Each effect of the catalogue and each
fault of samples is injected at sizes whose noise-free gap is a given multiple of the noise floor. Each
simulated log is diagnosed as the real one would be, many times.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from itertools import takewhile
from time import perf_counter
from typing import Any

import numpy as np
from scipy.stats import binomtest

from hallsym.diagnosis import QUIET, diagnose, prepare
from hallsym.diagnosis.setup import Setup
from hallsym.errors import InputError, require
from hallsym.estimation.calibration import INTERVAL, Fit
from hallsym.families.faults import FAULTS
from hallsym.log import Log
from hallsym.model import Effect, Model
from hallsym.power.injection import Injection, generator, injections, sized
from hallsym.power.simulated_machine import machine_of, on_part, simulated_noise
from hallsym.records import builtins
from hallsym.shown import Shown

NO_EFFECT = "no effect"
"""Name of a trial without an injection."""
RATIOS = (1.07, 1.3, 2.0)
"""Gap over noise floor of the sizes that are tried: at the threshold, clear, dominant."""
REPEATS = 20
"""Trials of each size: if all find it, it is found in at least 83 % (two-sided 95 %)."""
ROWS = 30_000
"""Samples of the part of a longer log: the fifth that is holdout gives a gap metric to 1 %."""


@dataclass(frozen=True)
class Trial:
    """One injection and the result of the blind diagnosis.

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

    @property
    def found(self) -> bool:
        """Whether the injected effect is named first, or in one group with the first."""
        return self.outcome in ("found", "group")

    @property
    def noticed(self) -> bool:
        """Whether the diagnosis found a gap."""
        return self.verdict not in QUIET


@dataclass(frozen=True)
class CurvePoint:
    """Detection at one size: `ratio`, gap over noise floor, None where nothing can be scaled.

    `found`: share of trials in which the effect was found, with its two-sided 95 % bounds `low` and `high`;
    `noticed`: share in which the diagnosis said that there is a gap.
    """

    ratio: float | None
    trials: int
    found: float
    low: float
    high: float
    noticed: float


def curve_point(ratio: float | None, found: Sequence[bool], noticed: Sequence[bool]) -> CurvePoint:
    """Return how often something was found and noticed in trials; nil of none."""
    n, count = len(found), int(sum(found))
    if not n:
        return CurvePoint(ratio, 0, 0.0, 0.0, 1.0, 0.0)
    low, high = binomtest(count, n).proportion_ci(INTERVAL)  # C. J. Clopper, E. S. Pearson 1934
    return CurvePoint(ratio, n, count / n, float(low), float(high), sum(noticed) / n)


@dataclass(frozen=True)
class Findable:
    """The result of the trials of one effect.

    `status`: "found" (from `ratio` on, in 90 % of the trials), "not found", "not testable" (`reason` says
    why) or "not run". `form`: how it was injected. `gap_m` and `size` are those of `ratio`; `confused_with`:
    named beside or instead of it. `curve`: how often it was found at each size.
    """

    name: str
    status: str
    reason: str = ""
    form: str = ""
    ratio: float | None = None
    gap_m: float | None = None
    size: dict[str, tuple[float, str]] = field(default_factory=dict)
    confused_with: tuple[str, ...] = ()
    curve: tuple[CurvePoint, ...] = ()
    trials: tuple[Trial, ...] = ()


@dataclass(frozen=True, repr=False)
class DetectionPower(Shown):
    """Result of `detection_power`; `complete` is False where an interrupt ended it early.

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
    noise: str
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
        require(name in known, "Effect", "one that was tried", name, known)
        return self.effects[known.index(name)]


class Bench:
    """The context of all trials: the simulated machine, its noise, and the settings of a diagnosis.

    `reasons`: effect -> why it cannot be injected. `injections(repeat)`: the others, by name, drawn anew for
    each repeat.
    """

    def __init__(self, setup: Setup, own: tuple[Effect, ...], seed: int, rows: int) -> None:
        self.setup, self.own, self.seed = setup, own, seed
        setup.say("modelling the noise")
        base = on_part(setup.base, rows)
        runs = [run for run in base.log.runs if run not in base.holdout]
        stated = frozenset(c for c, known in setup.fit.noise.sigmas.items() if known.source == "given")
        self.noise = simulated_noise(base, runs, setup.floor.uncertain == 1.0)
        self.truth = machine_of(base, setup.floor.metric * self.noise.ratio, stated)
        self.reasons: dict[str, str] = {}
        self.injections = lru_cache(1)(self._injections)

    def _injections(self, repeat: int) -> dict[str, Injection]:
        clean = self.truth.recording.clean
        nothing = Injection("", lambda _, noise: clean + noise, lambda _: {}, sized=False)
        made, reasons = injections(
            self.truth, self.setup.catalogue, lambda name: generator(self.seed, "draw", name, repeat)
        )
        self.reasons |= reasons
        return {NO_EFFECT: nothing, **made}

    def trial(self, name: str, ratio: float, repeat: int) -> Trial | None:
        """Inject an effect, diagnose blind and return the trial; None, with a reason, where it cannot be."""
        began, truth, injection = perf_counter(), self.truth, self.injections(repeat).get(name)
        if injection is None:
            return None
        size = sized(truth, injection, ratio) if injection.sized else (1.0, 0.0)
        if isinstance(size, str):
            self.reasons.setdefault(name, size)
            return None
        amount, gap_m = size
        rng = generator(self.seed, "noise", name, str(ratio), repeat)
        noise, reference = self.noise.draw(truth.recording.run, rng)
        log = truth.log(injection.make(amount, noise), reference)
        outcome, verdict, named = self.diagnosed(log, name)
        return Trial(
            name=name,
            ratio=ratio if injection.sized else None,
            repeat=repeat,
            gap_m=gap_m,
            size=injection.size(amount),
            outcome=outcome,
            verdict=verdict,
            named=named,
            seconds=perf_counter() - began,
        )

    def diagnosed(self, log: Log, name: str) -> tuple[str, str, tuple[str, ...]]:
        """Diagnose a simulated log; return outcome, verdict and the names of the first group."""
        setup = self.setup
        try:
            found = diagnose(
                log, setup.fit.model, effects=self.own, threshold=setup.threshold, policy=setup.policy,
            )  # fmt: skip
        except InputError:
            return "refused", "refused", ()
        if found.verdict in QUIET:
            return "no gap", found.verdict, ()
        ranked, named = found.ranked, [e.name for e in found.effects]
        if not ranked or not named:
            return "unexplained", found.verdict, ()
        group = next((g for g in found.groups if ranked[0] in g), (ranked[0],))
        outcome = "found" if ranked[0] == name else "group" if name in group else "listed"
        if outcome == "listed" and name not in named:
            outcome = "other"
        return outcome, found.verdict, group


def _run(
    bench: Bench, wanted: Sequence[str], ratios: Sequence[float], repeats: int
) -> tuple[list[Trial], bool]:
    """Run the trials of each repeat, the largest size of every effect first.

    Returned are the trials, and whether no interrupt ended them.
    """
    made = bench.injections(0)
    names = [n for n in made if n in (NO_EFFECT, *wanted)]
    each = {n: ratios if made[n].sized or n == NO_EFFECT else ratios[-1:] for n in names}
    plan = [(n, r, k) for k in range(repeats) for r in reversed(ratios) for n in names if r in each[n]]
    out: list[Trial] = []
    began, left = perf_counter(), ""
    try:
        for k, (name, ratio, repeat) in enumerate(plan):
            if k:
                minutes = (perf_counter() - began) / k * (len(plan) - k) / 60
                left = f", {k} of {len(plan)} trials done, about {minutes:.1f} min left"
            bench.setup.say(f"{name} at {ratio:g} x the noise floor{left}")
            trial = bench.trial(name, ratio, repeat)
            out += [trial] if trial else []
    except KeyboardInterrupt:
        return out, False
    return out, True


def detection_power(
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
    drop_bad: bool = False,
    on_progress: Callable[[str], None] | None = None,
) -> DetectionPower:
    """Return which effects a diagnosis of `log` would find, and above which size.

    `names`: effects and faults to try (default: all). `ratios`: gap over noise floor of the sizes, above 1.
    `repeats`: trials of each size, with other signs, instants and noise. `rows`: samples of a longer log that
    are used, in stretches at the full rate. `model`, `holdout`, `effects`, `threshold` as in `diagnose`. The
    largest size of every effect is tried first; a keyboard interrupt ends it early and returns the trials so
    far with `complete` False.

    Raises `InputError` for an unknown name, a ratio not above 1, and wherever `diagnose` does.
    """
    began = perf_counter()
    sizes = "gaps over the noise floor, each a number above 1"
    require(
        ratios and all(1 < r < np.inf for r in ratios), "Sizes of the detection power", sizes, list(ratios)
    )
    ratios = tuple(sorted(set(ratios)))
    for name, value in (("repeats", repeats), ("rows", rows)):
        require(value >= 1, f"Input {name} of the detection power", "1 or more", value)
    setup = prepare(
        log, model, holdout=holdout, effects=effects, threshold=threshold, drop_bad=drop_bad,
        on_progress=on_progress,
    )  # fmt: skip
    wanted = _wanted(names, setup.catalogue)
    bench = Bench(setup, tuple(effects), seed, rows)
    trials, complete = _run(bench, wanted, ratios, repeats)
    quiet = tuple(t for t in trials if t.name == NO_EFFECT)
    alarms = [t.noticed for t in quiet]
    not_tested = (
        "The fitted model is the simulated machine and the recorded motion its motion: a gap that this log "
        "has is not part of the test."
    )
    return DetectionPower(
        effects=tuple(_findable(bench, name, [t for t in trials if t.name == name]) for name in wanted),
        false_alarms=sum(alarms),
        false_alarm_rate=curve_point(None, alarms, alarms),
        quiet_trials=quiet,
        floor_m=bench.truth.floor_m,
        threshold=setup.threshold,
        ratios=ratios,
        repeats=repeats,
        seed=seed,
        noise=bench.noise.text,
        rows=bench.truth.base.log.rows,
        model=setup.fit.model.name,
        outputs=setup.fit.model.pose,
        log=builtins(setup.fit.log) | {"holdout": list(setup.holdout)},
        complete=complete,
        notes=tuple(dict.fromkeys((not_tested, *setup.fit.notes))),
        seconds=perf_counter() - began,
    )


def _wanted(names: Sequence[str] | None, catalogue: Sequence[Effect]) -> tuple[str, ...]:
    known = list(dict.fromkeys((*(e.name for e in catalogue), *FAULTS)))
    if names is None:
        return tuple(known)
    require(names, "Effects to test", "at least one name", names)
    for name in names:
        require(name in known, "Effect to test", f"one of {', '.join(known)}", name, known)
    return tuple(dict.fromkeys(names))


def _findable(bench: Bench, name: str, trials: Sequence[Trial]) -> Findable:
    """Return the result of one effect, with the smallest size above which most trials find it."""
    reason, injection = bench.reasons.get(name, ""), bench.injections(0).get(name)
    own = sorted(trials, key=lambda t: (t.ratio or 0.0, t.repeat))
    by_size = {ratio: [t for t in own if t.ratio == ratio] for ratio in dict.fromkeys(t.ratio for t in own)}
    curve = [curve_point(r, [t.found for t in at], [t.noticed for t in at]) for r, at in by_size.items()]
    enough = list(takewhile(lambda p: 1 - p.found <= bench.setup.policy.minor, reversed(curve)))
    least = by_size[enough[-1].ratio][0] if enough else None
    return Findable(
        name=name,
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
