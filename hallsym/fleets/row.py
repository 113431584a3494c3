"""What one device gives: a fit that no other device waits for, as one small row."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np

from hallsym.errors import InputError, one_line
from hallsym.estimation import Fit, fit
from hallsym.estimation.task import model_of
from hallsym.families.machine_file import Machine
from hallsym.fleets.sources import Device
from hallsym.log import Log, read_log
from hallsym.model import Model

GOOD, AMISS, UNDETERMINED, NOT_CONVERGED, FAILED = (
    "good", "not described", "not determined", "not converged", "failed",
)  # fmt: skip
VERDICTS = {
    GOOD: "the model describes the log, and the log determines the model",
    AMISS: "the model does not describe the log, or the recording is at fault",
    UNDETERMINED: "the log leaves parameters open that another recording determines",
    NOT_CONVERGED: "the solver did not converge",
    FAILED: "the log could not be fitted",
}
"""What is said of a device, and what it means."""
VALUE, STD = "value:", "std:"
"""Prefixes of the columns of a parameter: its value and its standard uncertainty, in SI."""


@dataclass(frozen=True)
class Settings:
    """How each log is read and fitted; the same for all. See `fit` and `read_log`."""

    model: str | None = None
    effects: tuple[str, ...] = ()
    machine: Machine = field(default_factory=lambda: Machine(None, {}))
    reading: Mapping[str, Any] = field(default_factory=dict)
    drop_bad: bool = False
    diagnose: bool = False


def row_of(asked: Settings, device: Device) -> dict[str, Any]:
    """Return the row of one device. Raises `InputError` for a log that cannot be fitted."""
    began = perf_counter()
    log = read_log(device.log, drop_bad=asked.drop_bad, **asked.reading)
    log = replace(log, meta=asked.machine.applied(log.meta))
    found = fit(log, _model(log, asked), solver="direct", drop_bad=asked.drop_bad, quick=True)
    row = row_of_fit(found) | (_diagnosed(log, found, asked) if asked.diagnose else {})
    return {**row, "seconds": perf_counter() - began}


def _model(log: Log, asked: Settings) -> Model:
    """Return the model of a device; numbers of effects that are left open are those its own log shows."""
    parameters = asked.machine.parameters
    if not asked.effects:
        return model_of(log, asked.model, (), parameters)
    from hallsym.diagnosis import model_on  # what most fleets do not need takes a second to import

    return model_on(log, asked.model, asked.effects, parameters=parameters, drop_bad=asked.drop_bad)


def row_of_fit(found: Fit) -> dict[str, Any]:
    """Return what a fleet keeps of a fit."""
    goodness = found.goodness
    assert goodness is not None
    free = [p.name for p in found.model.parameters if p.width > 0]
    return record(found, *verdict_of(found), free) | {
        "residual_over_noise": float(goodness.residual_over_noise),
        "cost_per_degree_of_freedom": float(goodness.cost_per_degree_of_freedom),
        "worst_run": int(goodness.worst_run),
        "worst_channel": goodness.worst_channel,
    }


def record(found: Fit, verdict: str, reason: str, kept: Sequence[str]) -> dict[str, Any]:
    """Return the columns of every device: what is said of its fit, and the parameters that are `kept`."""
    row: dict[str, Any] = {
        "verdict": verdict,
        "reason": one_line(reason),
        "model": found.model.name,
        "effects": ",".join(found.model.effects),
        "rows": found.log.rows,
        "runs": found.log.runs,
    }
    for name, value, std in zip(found.model.names, found.values, found.std, strict=True):
        if name in kept:
            row[f"{VALUE}{name}"] = float(value)
            row[f"{STD}{name}"] = float(std) if np.isfinite(std) else None
    return row


def verdict_of(found: Fit) -> tuple[str, str]:
    """Return the verdict on a fit and the sentence that says why; "" where it is good."""
    amiss = found.goodness.sentence if found.goodness else None
    if found.status != "converged":
        return NOT_CONVERGED, found.message
    if found.claims:
        return AMISS, found.claims[0].text  # it explains what the model leaves, if it leaves any
    if amiss:
        return AMISS, amiss
    nominal = {p.name: p.nominal for p in found.model.parameters}
    for pressed in found.at_bound:  # by however little: its value is not the device's
        if np.isclose(found.value(pressed), nominal[pressed], atol=1e-12):
            continue  # an effect is merely absent
        return AMISS, (
            f"{pressed} ends at its bound, {found.value(pressed):.6g}, so other parameters make up for it; "
            "widen the bound (--machine), or look at this device."
        )
    if found.undetermined_by_log:
        return UNDETERMINED, f"{', '.join(found.undetermined_by_log)} are not determined by this log."
    return GOOD, ""


def _diagnosed(log: Any, found: Fit, asked: Settings) -> dict[str, Any]:
    """Return the diagnosis of a device in words that group devices."""
    from hallsym.diagnosis import diagnose  # as `model_on` above

    try:
        result = diagnose(log, found.model, drop_bad=asked.drop_bad)
    except InputError as error:
        return {"diagnosis": "not possible", "causes": "", "diagnosis_reason": one_line(str(error))}
    # the effects that were found, each with those that are confusable with it on this log
    confusable = {name: sorted(group) for group in result.groups for name in group}
    causes = sorted({" or ".join(confusable.get(e.name, [e.name])) for e in result.effects})
    reason = one_line(result.sentence)
    return {"diagnosis": result.verdict, "causes": " + ".join(causes), "diagnosis_reason": reason}
