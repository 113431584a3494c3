"""An effect, or a fault of recordings, explained: `hallsym info hysteresis`."""

from collections.abc import Mapping
from typing import Any

from hallsym.errors import InputError
from hallsym.families import FAMILIES, effects
from hallsym.families.faults import FAULTS
from hallsym.model import Effect, Family, Model, Parameter, Variant, ways_text
from hallsym.model.arguments import REQUIRED, example_facts
from hallsym.report.tables import grid
from hallsym.units import parameter_unit

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
    return {"effect": name, "families": {f.name: _of_family(f, effects(f)[name]) for f in having}}


def _of_family(family: Family, effect: Effect) -> dict[str, Any]:
    model, variants = _tried(family, effect)
    wide = [v.make(model) for v in variants]
    old = {p.name for p in (*model.parameters, *model.zeros)}
    new = {p.name: p for m in wide for p in (*m.parameters, *m.zeros) if p.name not in old}
    texts = [effect.text(**v.numbers) for v in variants]
    return {
        "link": effect.link,
        "meaning": effect.meaning,
        "numbers": {n: _number(effect, n) for n in effect.numbers},
        "parameters": {p.name: _parameter(p) for p in new.values()},
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


def _number(effect: Effect, name: str) -> dict[str, Any]:
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


def _parameter(p: Parameter) -> dict[str, Any]:
    return {
        "unit": p.unit, "nominal": p.nominal, "lower": p.lower, "upper": p.upper, "meaning": p.meaning,
    }  # fmt: skip


def effect_text(record: Mapping[str, Any]) -> str:
    """Return what `hallsym info NAME` prints."""
    if "fault" in record:
        return (
            f"{record['fault']} ({record['link']}): {record['meaning']}.\n"
            f"A fault of the recording, which no model holds: {record['remedy']}"
        )
    return "\n\n".join(_section(record["effect"], family, r) for family, r in record["families"].items())


def _section(name: str, family: str, r: Mapping[str, Any]) -> str:
    parts = [f"{name} of the {family} family, link {r['link']}: {r['meaning']}"]
    if r["numbers"]:
        rows = [[n, e["unit"] or "", _default(e), _meaning(e)] for n, e in r["numbers"].items()]
        parts += ["", grid([["number", "unit", "default", "meaning"], *rows], left=3, words=True)]
    rows = []
    for n, p in r["parameters"].items():
        factor, unit = parameter_unit(p["unit"])
        ends = (f"{p[end] * factor:g}" for end in ("nominal", "lower", "upper"))
        rows.append([n, unit, *ends, p["meaning"]])
    head = [f"adds to {r['parameters_of']}", "unit", "nominal", "lower", "upper", "meaning"]
    parts += ["", grid([head, *rows], left=2, words=True), ""] if rows else [""]
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
