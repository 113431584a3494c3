"""A model explained: its family, chain of links, columns, parameters, zeros and the effects it can take."""

from collections.abc import Mapping, Sequence
from math import inf, isclose
from typing import Any

from hallsym.families import effects
from hallsym.model import LINKS, Model, Parameter
from hallsym.report.tables import grid
from hallsym.units import parameter_unit


def model_record(model: Model) -> dict[str, Any]:
    """Return what a model is, as `hallsym info MODEL --json` prints it: SI, null for infinite bounds."""
    taken = {*model.effects, *(text.partition(":")[0] for text in model.texts.values())}
    return {
        "model": model.name,
        "family": model.family.name,
        "chain": [
            {"link": link, "steps": sum(name == link for name, _ in model.steps)}
            for link in LINKS
            if any(name == link for name, _ in model.steps)
        ],
        "effects": list(model.effects),
        "pose": [
            {"column": c, "reference": r, "period": model.period.get(c)}
            for c, r in zip(model.pose, model.references, strict=True)
        ],
        "state": list(model.state),
        "channels": list(model.channels),
        "parameters": [_entry(p) for p in model.parameters],
        "combinations": [{"expression": c.expression, "unit": c.unit} for c in model.combinations],
        "zeros": [_entry(z) for z in model.zeros],
        "can_take": sorted(
            name
            for name, effect in effects(model.family).items()
            if name not in taken and not taken & set(effect.unless)
        ),
    }


def _entry(p: Parameter) -> dict[str, Any]:
    lower, upper = (None if abs(v) == inf else v for v in (p.lower, p.upper))
    return {
        "name": p.name, "unit": p.unit, "nominal": p.nominal, "lower": lower, "upper": upper,
        "meaning": p.meaning,
    }  # fmt: skip


def model_text(record: Mapping[str, Any]) -> str:
    """Return the record of a model for a person."""
    links = " -> ".join(entry["link"] for entry in record["chain"])
    pose = ", ".join(p["column"] + _period(p) for p in record["pose"])
    lines = [
        f"{record['model']}, a model of the family {record['family']}",
        "",
        f"chain: pose -> {links} -> reading",
        f"pose: {pose}",
        f"references: {', '.join(p['reference'] for p in record['pose'])}",
        f"state: {', '.join(record['state']) or 'none'}",
        f"channels: {', '.join(record['channels'])}",
        f"effects in it: {', '.join(record['effects']) or 'none'}",
        "",
        _table("parameter", record["parameters"]),
    ]
    if record["combinations"]:
        names = ", ".join(c["expression"] for c in record["combinations"])
        lines += ["", f"combinations that may be determined where parameters are not: {names}"]
    lines += ["", _table("zero of each run", record["zeros"]) if record["zeros"] else "zeros of a run: none"]
    lines += ["", f"effects it can take (--effect): {', '.join(record['can_take']) or 'none'}"]
    return "\n".join(lines)


def _period(coordinate: Mapping[str, Any]) -> str:
    period = coordinate["period"]
    return f" (repeats every {period:.6g} {coordinate['column'].rpartition('_')[2]})" if period else ""


def _table(what: str, entries: Sequence[Mapping[str, Any]]) -> str:
    rows = [[what, "unit", "nominal", "lower", "upper", "meaning"]]
    for e in entries:
        fixed = e["lower"] is not None and e["upper"] is not None and isclose(e["lower"], e["upper"])
        factor, unit = parameter_unit(e["unit"])
        ends = [_number(e["lower"], factor, "-inf"), _number(e["upper"], factor, "inf")]
        ends = ["fixed", ""] if fixed else ends
        rows.append([e["name"], unit, f"{e['nominal'] * factor:.6g}", *ends, e["meaning"]])
    return grid(rows, left=2, words=True)


def _number(value: float | None, factor: float, none: str) -> str:
    return none if value is None else f"{value * factor:.6g}"
