"""Two diagnoses (or two calibrations) of one machine, before and after a repair: what changed.

The records are those that `hallsym diagnose -o` and `hallsym fit -o` write. Parameters are compared by their
standard uncertainties, taken as independent: two recordings share no noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.words import gap_text, gap_unit
from hallsym.errors import InputError, quoted
from hallsym.estimation.calibration import FORMAT, read_record
from hallsym.inference import Estimate, Freedom, ParameterChange, changes
from hallsym.reading import read_json

Calibration = Mapping[str, Any]
"""What `Fit.to_dict` returns and `hallsym fit -o` writes."""


@dataclass(frozen=True)
class EffectChange:
    """An effect in the two records. `state`: "stays", "gone" or "came"; `remark`: what qualifies that.

    `share`: part of the excess above the noise floor that it closes, before and after.
    """

    name: str
    state: str
    share: tuple[float | None, float | None]
    form: tuple[str, str]
    parameters: tuple[ParameterChange, ...]
    remark: str = ""


@dataclass(frozen=True)
class Comparison:
    """What changed between two records of one machine. Pairs are (before, after); SI units.

    `kind`: "diagnoses" or "calibrations"; of the latter parameters are compared, and nothing else. `gap`,
    `rest`, `floor`: gap metric [m] of the model, with the effects that were found, and of the noise. `rmse`:
    output -> its error on the holdout runs, without effects.
    """

    kind: str
    model: str
    sentence: str
    effects: tuple[EffectChange, ...]
    verdict: tuple[str, str] = ("", "")
    gap: tuple[float, float] = (0.0, 0.0)
    rest: tuple[float, float] = (0.0, 0.0)
    floor: tuple[float, float] = (0.0, 0.0)
    rmse: dict[str, tuple[float, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain JSON data."""
        return asdict(self)


Source = Diagnosis | Mapping[str, Any] | str | Path


def compare(before: Source, after: Source) -> Comparison:
    """Return what changed between two diagnoses of one machine, or two calibrations.

    Each is a `Diagnosis`, what its `to_dict` returns, or the JSON file that a command wrote. Raises
    `InputError` for a file that is no such record and for records of different models or outputs.
    """
    old, new = _record(before, "before"), _record(after, "after")
    models = tuple(r.model if isinstance(r, Diagnosis) else r["model"] for r in (old, new))
    if models[0] != models[1] and type(old) is type(new):
        raise InputError(
            f"Records to compare must be of one model; before is of {models[0]}, after of {models[1]}."
        )
    if isinstance(old, Diagnosis) and isinstance(new, Diagnosis):
        return _diagnoses(old, new)
    if isinstance(old, Diagnosis) or isinstance(new, Diagnosis):
        raise InputError(
            "Records to compare must be two diagnoses or two calibrations; one of each was given."
        )
    return _calibrations(old, new)


def _record(source: Source, which: str) -> Diagnosis | Calibration:
    if isinstance(source, Diagnosis):
        return source
    where = f"Record {which!r}"
    if isinstance(source, str | Path):
        where, path = f"Record {quoted(source)}", source
        make = f"make one with 'hallsym diagnose LOG -o {source}'"
        source = read_json(source, "Record", "make it again", make)
        if isinstance(source, Mapping) and source.get("format") == FORMAT:
            read_record(source, path)
    if isinstance(source, Mapping):
        if source.get("format") == FORMAT and "parameters" in source and "model" in source:
            return source
        if "verdict" in source:
            return Diagnosis.from_dict(source, where)
    raise InputError(
        f"{where} must be what 'hallsym diagnose -o' or 'hallsym fit -o' writes; it is something else."
    )


# -- diagnoses ---------------------------------------------------------------------------------------------


def _diagnoses(old: Diagnosis, new: Diagnosis) -> Comparison:
    outputs, others = tuple(old.gap_before.rmse), tuple(new.gap_before.rmse)
    if outputs != others:
        raise InputError(
            f"Records to compare must have the same outputs; before has {', '.join(outputs)}, "
            f"after {', '.join(others)}."
        )
    effects = _effects(old, new)
    return Comparison(
        kind="diagnoses",
        model=old.model,
        sentence=_sentence(old, new, effects),
        verdict=(old.verdict, new.verdict),
        gap=(old.metric.before, new.metric.before),
        rest=(old.metric.after, new.metric.after),
        floor=(old.metric.floor, new.metric.floor),
        rmse={c: (old.gap_before.rmse[c], new.gap_before.rmse[c]) for c in outputs},
        effects=effects,
        notes=_notes(old, new),
    )


def _effects(old: Diagnosis, new: Diagnosis) -> tuple[EffectChange, ...]:
    """Return the effects of both records: those that are gone, those that came, those that stay."""
    one, two = ({e.name: e for e in d.effects} for d in (old, new))
    both = [n for n in one if n in two]
    same = [n for n in both if one[n].variant == two[n].variant]
    limit = POLICY.false_alarm / max(sum(len(one[n].parameters.keys() & two[n].parameters) for n in same), 1)
    out = []
    for n in (*(n for n in one if n not in two), *(n for n in two if n not in one), *both):
        a, b = one.get(n), two.get(n)
        if a and b:
            state, remark = "stays", "" if n in same else "its form changed: no parameters compared"
        else:
            state, when, other = ("gone", "after", new) if a else ("came", "before", old)
            reason = _reason(n, other)
            remark = f"{when}, {reason}" if reason else ""
        share = (a.share if a else None, b.share if b else None)
        form = (a.variant if a else "", b.variant if b else "")
        moved = changes(a.parameters, b.parameters, limit) if a and b and n in same else ()
        out.append(EffectChange(n, state, share, form, moved, remark))
    return tuple(out)


def _reason(name: str, other: Diagnosis) -> str:
    """Return why a record may lack an effect; nothing where it does not say."""
    groups = [g for g in other.groups if name in g]
    partner = next((e.name for e in other.effects for g in groups if e.name in g), None)
    if partner:
        return f"the log cannot tell it from {partner}"
    if name in other.not_testable:
        return f"not testable: {other.not_testable[name]}"
    smaller = next((f for f in other.smaller_findings if f.name == name), None)
    return f"below the threshold: {100 * smaller.shrinkage:.2g} %" if smaller else ""


def _notes(old: Diagnosis, new: Diagnosis) -> tuple[str, ...]:
    notes = []
    if old.threshold != new.threshold:
        notes.append(
            f"The thresholds differ: {100 * old.threshold:g} % before, {100 * new.threshold:g} % after."
        )
    unit, most = gap_unit(old.gap_before.rmse), 1 + POLICY.unstructured
    a, b = old.metric.floor, new.metric.floor
    if not 1 / most < b / max(a, 1e-300) < most:
        notes.append(
            f"The noise floors differ: {gap_text(a, unit)} before, {gap_text(b, unit)} after; one log may "
            "hide what the other shows."
        )
    return tuple(notes)


def _sentence(old: Diagnosis, new: Diagnosis, effects: Sequence[EffectChange]) -> str:
    unit = gap_unit(old.gap_before.rmse)
    said = []
    for d, noun in ((old, " the noise floor"), (new, "")):
        times = d.metric.before / max(d.metric.floor, 1e-300)
        said.append(f"{gap_text(d.metric.before, unit)} ({times:.3g} x{noun}, {d.verdict})")
    text = f"The gap went from {said[0]} to {said[1]}"
    for state, word in (("gone", "gone"), ("came", "new"), ("stays", "still there")):
        names = [e.name for e in effects if e.state == state]
        text += f"; {word}: {', '.join(names)}" if names else ""
    return text + "."


# -- calibrations ------------------------------------------------------------------------------------------


def _calibrations(old: Calibration, new: Calibration) -> Comparison:
    if old["effects"] != new["effects"]:
        raise InputError(
            f"Calibrations to compare must have the same effects; before has {', '.join(old['effects'])}, "
            f"after {', '.join(new['effects'])}."
        )
    one, two = (
        {
            n: Estimate(p["value"], p["std"], p["unit"])
            for n, p in r["parameters"].items()
            if p["determined"] and not p["held"]
        }
        for r in (old, new)
    )
    free: list[Freedom] = [
        {n: p["degrees_of_freedom"] for n, p in r["parameters"].items() if p.get("degrees_of_freedom")}
        for r in (old, new)
    ]
    limit = POLICY.false_alarm / max(len(set(one) & set(two)), 1)
    changed = changes(one, two, limit, (free[0], free[1]))
    left = sorted((set(old["parameters"]) | set(new["parameters"])) - {c.name for c in changed})
    moved = [c.name for c in changed if c.significant]
    return Comparison(
        kind="calibrations",
        model=old["model"],
        sentence=f"{len(moved)} of {len(changed)} parameters changed significantly"
        + (f": {', '.join(moved)}." if moved else "."),
        effects=(EffectChange(old["model"], "stays", (None, None), ("", ""), changed),),
        notes=(f"Not compared, not identifiable in one or both: {', '.join(left)}.",) if left else (),
    )
