"""A model, an effect or a fault of recordings explained: `hallsym info NAME`."""

from collections.abc import Mapping, Sequence
from math import inf, isclose
from typing import Any, cast

from hallsym.errors import InputError
from hallsym.families import FAMILIES, effects
from hallsym.families.faults import FAULTS
from hallsym.model import LINKS, Effect, Family, Model, Parameter, Variant, ways_text
from hallsym.model.arguments import REQUIRED, example_facts
from hallsym.report.tables import grid
from hallsym.units import parameter_unit

# -- a model: its family, chain of links, columns, parameters, zeros and the effects it can take ---------


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
        "parameters": [{"name": p.name, **_entry(p)} for p in model.parameters],
        "combinations": [{"expression": c.expression, "unit": c.unit} for c in model.combinations],
        "zeros": [{"name": z.name, **_entry(z)} for z in model.zeros],
        "can_take": sorted(
            name
            for name, effect in effects(model.family).items()
            if name not in taken and not taken & set(effect.unless)
        ),
    }


def _entry(p: Parameter) -> dict[str, Any]:
    lower, upper = (None if abs(v) == inf else v for v in (p.lower, p.upper))
    return {
        "unit": p.unit, "nominal": p.nominal, "lower": lower, "upper": upper, "meaning": p.meaning,
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


# -- an effect, or a fault of recordings -----------------------------------------------------------------


UNITS = {"m": "m", "s": "s", "rad": "rad", "deg": "deg", "hz": "Hz", "v": "V", "degc": "degC"}
"""Last part of the name of a number -> its unit."""


def is_explained(name: str) -> bool:
    """Return whether a name is that of an effect or of a fault of recordings."""
    return name in effects() or name in FAULTS


def effect_record(name: str) -> dict[str, Any]:
    """Return what `hallsym info NAME --json` prints, with an entry for each family that has the effect."""
    if name in FAULTS:
        fault = FAULTS[name]
        return {
            "fault": name, "link": fault.link, "meaning": fault.meaning, "remedy": fault.remedy,
        }  # fmt: skip
    having = [family for family in FAMILIES if name in effects(family)]
    records = {f.name: _of_family(f, effects(f)[name]) for f in having}
    if all("error" in record for record in records.values()):
        raise InputError(records[having[0].name]["error"])
    return {"effect": name, "families": records}


def _of_family(family: Family, effect: Effect) -> dict[str, Any]:
    """What the effect is in a family; its "error" where code of that family fails."""
    try:
        return cast("dict[str, Any]", family.made(_explained, family, effect))
    except InputError as error:
        return {"error": str(error)}


def _explained(family: Family, effect: Effect) -> dict[str, Any]:
    model, variants = _tried(family, effect)
    wide = [v.make(model) for v in variants]
    old = {p.name for p in (*model.parameters, *model.zeros)}
    new = {p.name: p for m in wide for p in (*m.parameters, *m.zeros) if p.name not in old}
    texts = [effect.text(**v.numbers) for v in variants]
    return {
        "link": effect.link,
        "meaning": effect.meaning,
        "numbers": {n: _argument(effect, n) for n in effect.numbers},
        "parameters": {p.name: _entry(p) for p in new.values()},
        "parameters_of": model.name,
        "needs": list(effect.needs),
        "separate": ways_text(effect.separate) if effect.diagnosed else None,
        "diagnosed": effect.diagnosed,
        "examples": list(dict.fromkeys([texts[0], texts[-1]])),
    }


def _tried(family: Family, effect: Effect) -> tuple[Model, list[Variant]]:
    """The first model of a family that can have the effect, and the variants of it."""
    models = sorted((make() for make in family.models), key=lambda m: m.name != family.default)
    for model in models:
        variants = [] if effect.name in model.effects else effect.variants(model, example_facts(model))
        if variants:
            return model, variants
    raise InputError(f"Effect {effect.name} is part of every model of family {family}.")


def _argument(effect: Effect, name: str) -> dict[str, Any]:
    number = effect.numbers[name]
    usual = None if number.default is REQUIRED else number.default
    return {
        "unit": UNITS.get(name.rpartition("_")[2]) if "_" in name else None,
        "meaning": number.meaning,
        "default": list(usual) if isinstance(usual, tuple) else usual,
        "choices": list(number.choices) or None,
        "found_on_log": number.default is REQUIRED,
        "instead_of": list(effect.forms[0]) if number.instead else None,
    }


def effect_text(record: Mapping[str, Any]) -> str:
    """Return what `hallsym info NAME` prints."""
    if "fault" in record:
        return (
            f"{record['fault']} ({record['link']}): {record['meaning']}.\n"
            f"A fault of the recording, which no model holds: {record['remedy']}"
        )
    return "\n\n".join(_section(record["effect"], family, r) for family, r in record["families"].items())


def _section(name: str, family: str, r: Mapping[str, Any]) -> str:
    if "error" in r:
        return f"{name} of the {family} family: {r['error']}"
    parts = [f"{name} of the {family} family, link {r['link']}: {r['meaning']}"]
    if r["numbers"]:
        rows = [[n, e["unit"] or "", _default(e), _meaning(e)] for n, e in r["numbers"].items()]
        parts += ["", grid([["number", "unit", "default", "meaning"], *rows], left=3, words=True)]
    added = [{"name": n, **p} for n, p in r["parameters"].items()]
    parts += ["", _table(f"adds to {r['parameters_of']}", added), ""] if added else [""]
    if r["needs"]:
        parts.append(f"needs the columns: {', '.join(r['needs'])}")
    if r["separate"]:
        parts.append(f"shows by itself in: {r['separate']}")
    return "\n".join([*parts, *(f"example: hallsym fit LOG --effect {text}" for text in r["examples"])])


def _default(entry: Mapping[str, Any]) -> str:
    if entry["found_on_log"]:
        return "from the log"
    usual = entry["default"]
    return "/".join(map(str, usual)) if isinstance(usual, list) else str(usual)


def _meaning(entry: Mapping[str, Any]) -> str:
    said = entry["meaning"]
    if entry["choices"]:
        said += f" (one of {', '.join(map(str, entry['choices']))})"
    return said + (f"; instead of {', '.join(entry['instead_of'])}" if entry["instead_of"] else "")
