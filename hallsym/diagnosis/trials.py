"""Trials of a self-test: an effect injected at a size into the simulated machine, diagnosed blind."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

from hallsym.diagnosis.engine import diagnose
from hallsym.diagnosis.facts import facts_of
from hallsym.diagnosis.injection import Injection, Sized, generator, injections, sized
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.setup import Setup
from hallsym.diagnosis.simulated_machine import (
    ResidualNoise,
    SimulatedMachine,
    decimated,
    machine_of,
    residual_noise,
)
from hallsym.diagnosis.survey import survey
from hallsym.errors import InputError
from hallsym.log import Log
from hallsym.model import Effect

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


class Bench:
    """What all trials share: the simulated machine, its noise, and how a simulated log is diagnosed.

    `reasons`: effect -> why it cannot be injected; `forms`: effect -> the form in which it is.
    """

    def __init__(self, setup: Setup, own: tuple[Effect, ...], seed: int, rows: int) -> None:
        self.setup, self.own, self.seed = setup, own, seed
        setup.say("decimating the log")
        base = replace(setup.base, timed=True)
        short = decimated(base, rows)
        base = replace(base, log=short.log, keep=None)
        self.decimation = short.text
        self.truth: SimulatedMachine = machine_of(base, setup.floor.metric)
        setup.say("modelling the noise")
        facts = facts_of(base, survey(base, frozenset(self.truth.runs)))
        self.noise: ResidualNoise = residual_noise(base, setup.catalogue, facts)
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

    def trial(self, injection: Injection | None, ratio: float, repeat: int) -> Trial | str:
        """Inject, diagnose blind and return the trial; the reason where nothing can be injected."""
        began, truth = perf_counter(), self.truth
        name, scaled = (injection.name, injection.sized) if injection else (NO_EFFECT, False)
        size = sized(truth, injection, ratio) if injection and scaled else Sized(1.0, 0.0)
        if size.reason:
            return size.reason
        noise = self.noise.draw(truth.columns["run"], generator(self.seed, "noise", name, str(ratio), repeat))
        readings = injection.make(size.amount, noise) if injection else truth.clean + noise
        outcome, verdict, named = self.diagnosed(truth.log(readings), name)
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
    if found.verdict == "no gap":
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


def _left(seconds: float, done: int, total: int) -> str:
    if not done:
        return ""
    minutes = seconds / done * (total - done) / 60
    return f", {done} of {total} effects done, about {minutes:.1f} min left"
