"""Whether a log can be what it says, judged by linear coefficients of its runs before a solver sees them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from hallsym.errors import InputError
from hallsym.estimation.likelihood import Cost
from hallsym.estimation.responses import coupling_of, responses_of
from hallsym.estimation.start import LinearFit
from hallsym.log import Log
from hallsym.log.quality.explain import Explanation
from hallsym.log.quality.findings import Finding
from hallsym.log.quality.gains import judge_gains, said


@dataclass(frozen=True, eq=False)
class Judgement:
    """Findings on units, signs, order and runs, and what explains slopes of the whole log, the best first."""

    findings: tuple[Finding, ...] = ()
    whole: tuple[Explanation, ...] = ()
    spiky: bool = False
    """Whether spikes bend the slopes, so that nothing can be said before they are taken out."""

    def resolved(self, before: Judgement) -> Judgement:
        """Return this judgement of rewired channels with what else would explain those before."""
        others = [e for e in before.whole if not e.only_channels]
        if not others:
            return self
        text = f"Order and signs of channels are resolved; it would do as well that {said(others[0])}."
        return replace(self, findings=(*self.findings, Finding(text[:-1])))

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth a note."""
        return tuple(f.sentence for f in self.findings if not f.refuse)

    def refuse(self) -> None:
        """Raise `InputError` for the first finding that is no matter of opinion."""
        for finding in self.findings:
            if finding.refuse:
                raise InputError(finding.sentence)


def judge(
    log: Log, everything: Cost, merged: Cost, linear: LinearFit, holdout: Collection[int] = ()
) -> Judgement:
    """Judge the columns of a log by its cost; a run in `holdout` is no reason to refuse."""
    seen = responses_of(everything)
    if seen is None:
        return Judgement()
    gains = judge_gains(log, seen, holdout, _moved(coupling_of(merged, linear), everything))
    return Judgement(gains.findings, gains.whole)


def _moved(coupling: np.ndarray | None, everything: Cost) -> np.ndarray | float:
    """Return how far the state of each run moves the gain of each channel, relative, (runs, n_channels)."""
    if coupling is None:
        return 0.0
    state = everything.summary.first_state
    return np.asarray(np.abs(state - np.median(state, axis=0)) @ np.abs(coupling))
