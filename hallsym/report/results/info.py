"""A model, an effect or a fault of recordings explained: `hallsym info NAME`."""

from collections import Counter
from collections.abc import Mapping, Sequence
from math import inf, isclose
from typing import Any, cast

from hallsym.errors import InputError
from hallsym.families import FAMILIES, effects
from hallsym.families.faults import FAULTS
from hallsym.model import LINKS, Effect, Family, Model, Parameter, Variant, ways_text
from hallsym.model.arguments import REQUIRED, example_facts
from hallsym.report.content import Block, Content, Heading, Section, Table
from hallsym.report.words import number
from hallsym.units import parameter_unit

# -- a model: its family, chain of links, columns, parameters, offsets and the effects it can take ---------


def model_record(model: Model) -> dict[str, Any]:
    """Return the record of a model for `hallsym info MODEL --json`: SI, null for infinite bounds."""
    steps = Counter(link for link, _ in model.steps)
    taken = {*model.effects, *(text.partition(":")[0] for text in model.texts.values())}
    return {
        "model": model.name,
        "family": model.family.name,
        "chain": [{"link": link, "steps": steps[link]} for link in LINKS if steps[link]],
        "effects": list(model.effects),
        "pose": [
            {"column": c, "reference": r, "period": model.period.get(c)}
            for c, r in zip(model.pose, model.references, strict=True)
        ],
        "state": list(model.state),
        "channels": list(model.channels),
        "parameters": [{"name": p.name, **_entry(p)} for p in model.parameters],
        "combinations": [{"expression": c.expression, "unit": c.unit} for c in model.combinations],
        "offsets": [{"name": z.name, **_entry(z)} for z in model.offsets],
        "can_take": sorted(
            name
            for name, effect in effects(model.family).items()
            if name not in taken and not taken & set(effect.unless)
        ),
    }


def _entry(p: Parameter) -> dict[str, Any]:
    ends = {end: None if abs(v) == inf else v for end, v in (("lower", p.lower), ("upper", p.upper))}
    return {"unit": p.unit, "nominal": p.nominal, **ends, "meaning": p.meaning}


def model_content(record: Mapping[str, Any]) -> Content:
    """Return the record of a model for a person."""
    links = " -> ".join(entry["link"] for entry in record["chain"])
    pose = []
    for column, period in ((p["column"], p["period"]) for p in record["pose"]):
        every = f" (repeats every {number(period, 6)} {column.rpartition('_')[2]})" if period else ""
        pose.append(column + every)
    lines = [
        "",
        f"chain: pose -> {links} -> reading",
        f"pose: {', '.join(pose)}",
        f"references: {', '.join(p['reference'] for p in record['pose'])}",
        f"state: {', '.join(record['state']) or 'none'}",
        f"channels: {', '.join(record['channels'])}",
        f"effects in it: {', '.join(record['effects']) or 'none'}",
    ]
    blocks: list[Block | str] = [_table("parameter", record["parameters"])]
    if record["combinations"]:
        names = ", ".join(c["expression"] for c in record["combinations"])
        blocks.append(f"combinations that may be determined where parameters are not: {names}")
    blocks.append(
        _table("offset of each run", record["offsets"]) if record["offsets"] else "offsets of each run: none"
    )
    blocks.append(f"effects it can take (--effect): {', '.join(record['can_take']) or 'none'}")
    title = f"{record['model']}, a model of the family {record['family']}"
    count = f"{len(record['parameters'])} parameters, {len(record['channels'])} channels"
    return Content(title, f"{title}: {count}.", [Section("model", "Model", blocks)], lines)


def _table(what: str, entries: Sequence[Mapping[str, Any]]) -> Table:
    head, rows = [what, "unit", "nominal", "lower", "upper", "meaning"], []
    for e in entries:
        fixed = e["lower"] is not None and e["upper"] is not None and isclose(e["lower"], e["upper"])
        factor, unit = parameter_unit(e["unit"])
        ends = [
            number((v if e[k] is None else e[k]) * factor, 6) for k, v in (("lower", -inf), ("upper", inf))
        ]
        ends = ["fixed", ""] if fixed else ends
        rows.append([e["name"], unit, number(e["nominal"] * factor, 6), *ends, e["meaning"]])
    return Table(head, rows, what, left=2, wordy=(5,))


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
        return {"fault": name, "link": fault.link, "meaning": fault.meaning, "remedy": fault.remedy}
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
    old = {p.name for p in (*model.parameters, *model.offsets)}
    new = {p.name: p for m in wide for p in (*m.parameters, *m.offsets) if p.name not in old}
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


def effect_content(record: Mapping[str, Any]) -> Content:
    """Return the record of an effect, or of a fault of recordings, for a person."""
    if "fault" in record:
        answer = f"{record['fault']} ({record['link']}): {record['meaning']}."
        return Content(
            record["fault"],
            answer,
            first=[f"A fault of the recording, which no model holds: {record['remedy']}"],
        )
    name = record["effect"]
    first, *rest = ((family, _section(name, family, r)) for family, r in record["families"].items())
    others = [Section(family, family, [Heading(answer), *blocks]) for family, (answer, blocks) in rest]
    return Content(name, first[1][0], others, first[1][1])


def _section(name: str, family: str, r: Mapping[str, Any]) -> tuple[str, list[Block | str]]:
    """Return an effect of a family, in a sentence and in full."""
    if "error" in r:
        return f"{name} of the {family} family: {r['error']}", []
    blocks: list[Block | str] = []
    if r["numbers"]:
        rows = [[n, *_said(e)] for n, e in r["numbers"].items()]
        blocks.append(Table(["number", "unit", "default", "meaning"], rows, "numbers", left=3, wordy=(3,)))
    added = [{"name": n, **p} for n, p in r["parameters"].items()]
    blocks += [_table(f"adds to {r['parameters_of']}", added)] if added else []
    if r["needs"]:
        blocks.append(f"needs the columns: {', '.join(r['needs'])}")
    if r["separate"]:
        blocks.append(f"shows by itself in: {r['separate']}")
    blocks += [f"example: hallsym fit LOG --effect {text}" for text in r["examples"]]
    return f"{name} of the {family} family, link {r['link']}: {r['meaning']}", blocks


def _said(entry: Mapping[str, Any]) -> list[str]:
    """Return unit, default and meaning of a number of an effect."""
    usual, meaning = entry["default"], entry["meaning"]
    default = "/".join(map(str, usual)) if isinstance(usual, list) else str(usual)
    meaning += f" (one of {', '.join(map(str, entry['choices']))})" if entry["choices"] else ""
    meaning += f"; instead of {', '.join(entry['instead_of'])}" if entry["instead_of"] else ""
    return [entry["unit"] or "", "from the log" if entry["found_on_log"] else default, meaning]
