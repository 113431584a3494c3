"""The command that a diagnosis prints fits the model that it names, and leaves the error that it states."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "goldens"))

from golden_logs import LOGS, folder_of

import hallsym
from hallsym.diagnosis import Diagnosis, diagnose, model_on
from hallsym.diagnosis.decoded_errors import decoded_errors
from hallsym.diagnosis.setup import base_of
from hallsym.estimation import Fit
from hallsym.log import read_log

CLOSE = 0.02
"""Relative difference of the error of the same model, fitted by the two solvers: their covariance of the
reference's noise differs by what the effects change of the gains."""
PIECES = 0.35
"""The same where pieces of one recording judged, which the command fits: few samples judge."""


def option(words: tuple[str, ...], name: str) -> list[str]:
    return [words[k + 1] for k, word in enumerate(words) if word == name]


def left(d: Diagnosis, path: Path) -> tuple[float, float]:
    """Return the error that a diagnosis states by output, and that of the fit which its command makes."""
    log, (model,) = read_log(path), option(d.next_step, "--model")
    held = option(d.next_step, "--holdout")
    holdout = tuple(map(int, held[0].split(","))) if held else None
    wide = model_on(log, model, option(d.next_step, "--effect"), holdout=holdout)
    result: Fit = hallsym.fit(
        log, wide, solver="direct", holdout=holdout, corrections=option(d.next_step, "--correct")
    )
    if holdout:  # on the same samples: a fit without the effect leaves out what looked like spikes
        base = replace(base_of(log, result), keep=None)
        return d.metric.after, decoded_errors(base, holdout).metric
    row = result.errors.rows()["fitted"]
    weights = wide.family.pose_metric.weights(wide.pose, log.meta.gap_length_scale_m)
    fitted = np.array([row["rmse"][c] for c in wide.pose])
    said = np.array([d.gap_after.rmse[c] for c in wide.pose])
    return float(np.linalg.norm(weights * said)), float(np.linalg.norm(weights * fitted))


def check(path: Path) -> None:
    d = diagnose(read_log(path))
    if not d.next_step or any(not e.text for e in d.effects):
        return  # nothing to fit, or faults of samples that a fit does not repair
    said, found = left(d, path)
    close = CLOSE if "--holdout" in d.next_step else PIECES
    assert found == pytest.approx(said, rel=close), (d.ranked, said, found)


@pytest.mark.slow
@pytest.mark.parametrize("name", LOGS)
def test_the_command_leaves_the_error_that_is_stated(name):
    check(folder_of(name))
