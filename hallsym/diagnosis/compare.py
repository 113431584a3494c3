"""Two diagnoses (or two calibrations) of one machine, before and after a repair: what changed.

The records are those that `hallsym diagnose -o` and `hallsym fit -o` write. Parameters are compared by their
standard uncertainties, taken as independent: two recordings share no noise.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import erfc

from hallsym.diagnosis.record import Diagnosis
from hallsym.diagnosis.words import gap_text, gap_unit
from hallsym.errors import InputError
from hallsym.estimation.calibration import FORMAT

LEVEL = 0.05
"""Probability, over all parameters that are compared, of calling a change significant that is none."""
KEYS = ("verdict", "model", "metric", "gap_before", "gap_after", "noise_floor", "effects", "groups", "where")

Record = Mapping[str, Any]


@dataclass(frozen=True)
class ParameterChange:
    """A parameter in SI: values and standard uncertainties, `p_value` of no change (None: no uncertainty).

    `significant`: corrected for the number of parameters compared; None where it cannot be said.
    """

    name: str
    unit: str
    before: float
    before_std: float | None
    after: float
    after_std: float | None
    p_value: float | None
    significant: bool | None


@dataclass(frozen=True)
class EffectChange:
    """An effect in the two records. `state`: "stays", "gone" or "came"; `remark`: what qualifies that.

    `share`: part of the gap above the floor that it closes, before and after.
    """

    name: str
    state: str
    share: tuple[float | None, float | None]
    form: tuple[str, str]
    parameters: tuple[ParameterChange, ...]
    remark: str = ""


@dataclass(frozen=True)
class PlaceChange:
    """A statement on where the gap lies: share of the excess before and after, None where there is none."""

    by: str
    at: str
    share: tuple[float | None, float | None]
    text: tuple[str, str]


@dataclass(frozen=True)
class Comparison:
    """What changed between two records of one machine. Pairs are (before, after); SI units.

    `kind`: "diagnoses" or "calibrations". `gap`, `rest`, `floor`: gap metric [m] of the model, with the
    effects that were found, and of the noise. `rmse`: output -> its error of the model on held-out runs.
    """

    kind: str
    model: str
    sentence: str
    verdict: tuple[str, str]
    gap: tuple[float, float]
    rest: tuple[float, float]
    floor: tuple[float, float]
    rmse: dict[str, tuple[float, float]]
    effects: tuple[EffectChange, ...]
    where: tuple[PlaceChange, ...]
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as plain JSON data."""
        return asdict(self)


def compare(before: Diagnosis | Record | str | Path, after: Diagnosis | Record | str | Path) -> Comparison:
    """Say what changed between two diagnoses of one machine, or two calibrations.

    Each is a `Diagnosis`, what its `to_dict` returns, or the JSON file that a command wrote. Raises
    `InputError` for a file that is no such record and for records of different models or outputs.
    """
    old, new = _record(before, "before"), _record(after, "after")
    if (old.get("format") == FORMAT) != (new.get("format") == FORMAT):
        raise InputError(
            "Records to compare must be two diagnoses or two calibrations; one of each was given."
        )
    if old["model"] != new["model"]:
        raise InputError(
            f"Records to compare must be of one model; before is of {old['model']}, after of {new['model']}."
        )
    return _calibrations(old, new) if old.get("format") == FORMAT else _diagnoses(old, new)


def _record(source: Diagnosis | Record | str | Path, which: str) -> Record:
    if isinstance(source, Diagnosis):
        return source.to_dict()
    where = f"Record {which!r}"
    if isinstance(source, str | Path):
        where = f"Record {source}"
        try:
            raw = json.loads(Path(source).read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(
                f"{where} does not exist; make one with 'hallsym diagnose LOG -o {source}'."
            ) from None
        except (OSError, ValueError) as error:
            raise InputError(f"{where} cannot be read as JSON: {' '.join(str(error).split())}.") from None
        source = raw
    if isinstance(source, Mapping):
        calibration = source.get("format") == FORMAT and "parameters" in source and "model" in source
        if calibration or all(key in source for key in KEYS):
            return source
    raise InputError(
        f"{where} must be what 'hallsym diagnose -o' or 'hallsym fit -o' writes; it is something else."
    )


# -- diagnoses ---------------------------------------------------------------------------------------------


def _diagnoses(old: Record, new: Record) -> Comparison:
    outputs = [tuple(r["gap_before"]["rmse"]) for r in (old, new)]
    if outputs[0] != outputs[1]:
        raise InputError(
            f"Records to compare must have the same outputs; before has {', '.join(outputs[0])}, "
            f"after {', '.join(outputs[1])}."
        )
    gap, rest, floor = (
        (float(old["metric"][k]), float(new["metric"][k])) for k in ("before", "after", "floor")
    )
    effects = _effects(old, new)
    return Comparison(
        kind="diagnoses",
        model=old["model"],
        sentence=_sentence((old["verdict"], new["verdict"]), gap, floor, effects, gap_unit(outputs[0])),
        verdict=(old["verdict"], new["verdict"]),
        gap=gap,
        rest=rest,
        floor=floor,
        rmse={c: (old["gap_before"]["rmse"][c], new["gap_before"]["rmse"][c]) for c in outputs[0]},
        effects=effects,
        where=_places(old["where"], new["where"]),
        notes=_notes(old, new),
    )


def _effects(old: Record, new: Record) -> tuple[EffectChange, ...]:
    one, two = ({e["name"]: e for e in r["effects"]} for r in (old, new))
    pairs = [(one[n], two[n]) for n in one if n in two and one[n]["variant"] == two[n]["variant"]]
    count = sum(len(set(a["parameters"]) & set(b["parameters"])) for a, b in pairs)
    out = []
    for name in dict.fromkeys((*one, *two)):
        a, b = one.get(name), two.get(name)
        form = (a["variant"] if a else "", b["variant"] if b else "")
        share = (a["share"] if a else None, b["share"] if b else None)
        parameters: tuple[ParameterChange, ...] = ()
        if a and b:
            state, remark = "stays", "" if form[0] == form[1] else "its form changed: no parameters compared"
            if not remark:
                parameters = _parameters(a["parameters"], b["parameters"], count)
        else:
            state = "gone" if a else "came"
            remark = _remark(name, new if a else old, "after" if a else "before")
        out.append(EffectChange(name, state, share, form, parameters, remark))
    return tuple(sorted(out, key=lambda e: ("gone", "came", "stays").index(e.state)))


def _remark(name: str, other: Record, when: str) -> str:
    """Why an effect that one record names is missing in the other."""
    partner = next((e["name"] for e in other["effects"] for g in other["groups"]
                    if name in g and e["name"] in g), None)  # fmt: skip
    if partner:
        return f"{when}, the log cannot tell it from {partner}"
    if name in other.get("not_testable", {}):
        return f"{when}, not testable: {other['not_testable'][name]}"
    smaller = next((f for f in other.get("smaller_findings", ()) if f["name"] == name), None)
    if smaller:
        return f"{when}, below the threshold: {100 * smaller['shrinkage']:.2g} %"
    return ""


def _parameters(one: Record, two: Record, count: int) -> tuple[ParameterChange, ...]:
    """Compare parameters by name; `count`: how many are compared in all."""
    out = []
    for name in (n for n in one if n in two):
        a, b = one[name], two[name]
        p = None
        if a["std"] is not None and b["std"] is not None and np.hypot(a["std"], b["std"]) > 0:
            p = float(erfc(abs(b["value"] - a["value"]) / np.hypot(a["std"], b["std"]) / np.sqrt(2)))
        significant = None if p is None else p * max(count, 1) < LEVEL
        out.append(
            ParameterChange(name, a["unit"], a["value"], a["std"], b["value"], b["std"], p, significant)
        )
    return tuple(out)


def _places(one: Sequence[Record], two: Sequence[Record]) -> tuple[PlaceChange, ...]:
    before, after = ({(s["by"], s["at"]): s for s in r} for r in (one, two))
    out = []
    for key in dict.fromkeys((*before, *after)):
        a, b = before.get(key), after.get(key)
        out.append(
            PlaceChange(
                *key,
                (a["share"] if a else None, b["share"] if b else None),
                (a["text"] if a else "", b["text"] if b else ""),
            )
        )
    return tuple(out)


def _notes(old: Record, new: Record) -> tuple[str, ...]:
    notes = []
    if old.get("threshold") != new.get("threshold"):
        notes.append(
            f"The thresholds differ: {100 * old['threshold']:g} % before, {100 * new['threshold']:g} % after."
        )
    unit = gap_unit(old["gap_before"]["rmse"])
    a, b = float(old["metric"]["floor"]), float(new["metric"]["floor"])
    if not 1 / 1.2 < b / max(a, 1e-300) < 1.2:
        notes.append(
            f"The noise floors differ: {gap_text(a, unit)} before, {gap_text(b, unit)} after; what one log "
            "shows, the other may hide."
        )
    return tuple(notes)


def _sentence(
    verdict: tuple[str, str],
    gap: tuple[float, float],
    floor: tuple[float, float],
    effects: Sequence[EffectChange],
    unit: tuple[float, str],
) -> str:
    times = tuple(g / max(f, 1e-300) for g, f in zip(gap, floor, strict=True))
    said = (
        f"The gap went from {gap_text(gap[0], unit)} ({times[0]:.3g} x the noise floor, {verdict[0]}) to "
        f"{gap_text(gap[1], unit)} ({times[1]:.3g} x, {verdict[1]})"
    )
    for state, word in (("gone", "gone"), ("came", "new"), ("stays", "still there")):
        names = [e.name for e in effects if e.state == state]
        said += f"; {word}: {', '.join(names)}" if names else ""
    return said + "."


# -- calibrations ------------------------------------------------------------------------------------------


def _calibrations(old: Record, new: Record) -> Comparison:
    if old["effects"] != new["effects"]:
        raise InputError(
            f"Calibrations to compare must have the same effects; before has {', '.join(old['effects'])}, "
            f"after {', '.join(new['effects'])}."
        )
    one, two = (
        {n: p for n, p in r["parameters"].items() if p["determined"] and not p["held"]} for r in (old, new)
    )
    changed = _parameters(one, two, sum(n in two for n in one))
    left = sorted((set(old["parameters"]) | set(new["parameters"])) - {c.name for c in changed})
    moved = [c.name for c in changed if c.significant]
    return Comparison(
        kind="calibrations",
        model=old["model"],
        sentence=f"{len(moved)} of {len(changed)} parameters changed significantly"
        + (f": {', '.join(moved)}." if moved else "."),
        verdict=("", ""),
        gap=(0.0, 0.0),
        rest=(0.0, 0.0),
        floor=(0.0, 0.0),
        rmse={},
        effects=(EffectChange(old["model"], "stays", (None, None), ("", ""), changed),),
        where=(),
        notes=(f"Not compared, undetermined in one or both: {', '.join(left)}.",) if left else (),
    )
