"""Families of sensors: one folder each, physics only. Models and effects are looked up here by name."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from runpy import run_path
from typing import Any

from hallsym.errors import InputError, few, quoted, require, summary
from hallsym.families import halbach, rotary, stage
from hallsym.families.faults import FAULTS
from hallsym.files import MOST_NUMBER, regular
from hallsym.log import Meta
from hallsym.log.columns import is_moving
from hallsym.log.phase import followed
from hallsym.model import Effect, Family, Model
from hallsym.model.effect import as_effect, read_text

FAMILIES: tuple[Family, ...] = (stage.FAMILY, rotary.FAMILY, rotary.RING, halbach.FAMILY, halbach.PLANAR)
"""Families whose models and effects have names on the command line; shared code asks `Model.family`."""


def models(families: Sequence[Family] = ()) -> dict[str, Callable[..., Model]]:
    """Return every model by name; `families`: more than hallsym's own."""
    return {make.__name__: make for family in (*FAMILIES, *families) for make in family.models}


def family_called(model: str) -> Family | None:
    """Return the family that has a model or an alias of this name; None where none of hallsym's own has."""
    return next((f for f in FAMILIES if f.maker(model)), None)


def effects(*families: Family) -> dict[str, Effect]:
    """Return every effect by name, of some families or of all; of one name, that of the first family."""
    return {e.name: e for family in reversed(families or FAMILIES) for e in family.effects}


def known_effect(text: str, family: Family) -> bool:
    """Return whether an effect, named with or without numbers, is one of a family's own."""
    return read_text(text)[0] in effects(family)


def build(
    name: str,
    *,
    meta: Meta | None = None,
    added: tuple[str, ...] = (),
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    own: Mapping[str, Callable[[Model], Model]] | None = None,
    families: Sequence[Family] = (),
) -> Model:
    """Return the model called `name` for the machine that `meta` describes.

    `meta`: probe layout and nominal values of a log folder. `added`: effects by name, with their numbers
    where they have some (`hallsym.model.effect`). `parameters`: changed nominal values and bounds,
    `{"H1x": {"lower": .1}}`. `own`: the user's effects by name; `families`: the user's families. Raises
    `InputError` that lists known names.
    """
    found = [(f, make) for f in (*FAMILIES, *families) if (make := f.maker(name))]
    if not found:
        known = list(models(families))
        require(False, "Model", f"one of {', '.join(known)}", name, known)
    family, make = found[0]
    model = family.made(family.from_meta, make, meta or Meta())
    return adapted(model, added, parameters or {}, own)


def default_model(meta: Meta, log: str = "LOG") -> str:
    """Return the model where none is named: the log's own, else that of the family whose columns it has.

    `log`: the words that name it in a command. Raises `InputError` where the columns are of no family.
    """
    if meta.base_model:
        return meta.base_model
    if meta.columns and not any(map(is_moving, meta.columns)):
        log = log.replace("'", '"')  # the command stands between the others
        kinds = " nor ".join(f"{f.about.partition(';')[0].rstrip(')')})" for f in FAMILIES)
        raise InputError(
            f"The log's columns ({few(meta.columns, 3)}) are neither {kinds}; map columns with "
            f"--column FILE.toml ('hallsym info {log} --write' writes it), or name the model with --model."
        )
    fitting = (f for test in (Family.reads, Family.refers) for f in FAMILIES if test(f, meta.columns))
    family = next(fitting, FAMILIES[0])
    usual = family.model_of(meta.columns)
    names = [make.__name__ for make in family.models]
    simpler = names[: names.index(usual) + 1][::-1]
    fed = (name for name in simpler if set(followed(build(name, meta=meta))) <= set(meta.columns))
    return next(fed, usual)


def axes() -> tuple[str, ...]:
    """Return every coordinate and state that a campaign of a named family can move."""
    return tuple(dict.fromkeys(axis for f in FAMILIES for axis in f.axes))


def model_for(moved: Collection[str]) -> str:
    """Return the model to simulate where none is named: that of the first family with the axes moved."""
    return next((f.default for f in FAMILIES if set(moved) <= set(f.axes)), FAMILIES[0].default)


def adapted(
    model: Model,
    added: tuple[str, ...],
    parameters: Mapping[str, Mapping[str, Any]],
    own: Mapping[str, Callable[[Model], Model]] | None = None,
) -> Model:
    """Return `model` with effects added by name and with changed nominal values and bounds."""
    for effect in added:
        model = effect_named(effect, model, own).added(model, effect)
    return model.with_parameters(_checked(model, parameters))


def plain(model: Model) -> Model:
    """Return the model without the effects beyond those that its name stands for; bounds and nominals stay.

    One that has none of them, or no maker in its family, is returned as it is.
    """
    make = model.family.maker(model.name)
    base = make(model.layout) if make else model
    if base.effects == model.effects:
        return model
    mine = {p.name: p for p in (*model.parameters, *model.offsets)}
    kept = [mine[p.name] for p in (*base.parameters, *base.offsets) if p.name in mine]
    return base.with_parameters(
        {p.name: {"nominal": p.nominal, "lower": p.lower, "upper": p.upper} for p in kept}
    )


def added_effects(model: Model) -> Sequence[str]:
    """Return the effects that `model` has beyond those its name stands for, with their numbers."""
    make = model.family.maker(model.name)
    own = len((make(model.layout) if make else model).effects)
    new = [model.texts.get(effect, effect) for effect in model.effects[own:]]
    return list(dict.fromkeys(new))


def same_layout(model: Model, meta: Meta) -> bool:
    """Return whether a log's `meta.json` describes the machine of `model`, or none."""
    make = model.family.maker(model.name)
    if meta.probes is None or make is None:
        return True
    both = (model.family.from_meta(make, meta).layout, model.layout)
    mine, theirs = ([getattr(part, "stated", part) for part in layout] for layout in both)
    return mine == theirs


def effect_named(
    text: str, model: Model, own: Mapping[str, Callable[[Model], Model]] | None = None
) -> Effect:
    """Return the effect that a text names for `model`. Raises `InputError` that lists known names."""
    name, _ = read_text(text)
    if own and name in own:
        return as_effect(own[name])
    known = effects(model.family)
    if name in FAULTS:
        raise InputError(f"Effect {name} {FAULTS[name].refusal}")
    if name not in known:
        others = [f.name for f in FAMILIES if name in effects(f)]
        if others:
            raise InputError(
                f"Effect {name} belongs to {' and '.join(others)} models; model {model.name} is of family "
                f"{model.family}."
            )
    require(name in known, "Effect", f"one of {', '.join(known)}", name, list(known))
    return known[name]


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """Read the user's `EFFECTS`, a tuple of functions `Model -> Model` or of `Effect`s, from a Python file.

    Raises `InputError` for a file that cannot be run or names no effects.
    """
    path = regular(path, "Effects file")
    try:
        listed = run_path(str(path)).get("EFFECTS")
    except (Exception, SystemExit) as error:
        what = f"{type(error).__name__}: {summary(error)}"
        raise InputError(f"Effects file {quoted(path)} cannot be run ({what}); correct it.") from error
    if not isinstance(listed, Sequence) or not listed or not all(map(callable, listed)):
        raise InputError(f"Effects file {path} must define EFFECTS, a tuple of functions Model -> Model.")
    return tuple(map(as_effect, listed))


def _checked(model: Model, changes: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Turn `fixed = true` into equal bounds and refuse bounds that exclude the start the user gave."""
    nominal = {p.name: p for p in (*model.parameters, *model.offsets)}
    out: dict[str, dict[str, float]] = {}
    for name, raw in changes.items():
        entry = dict(raw)
        for key, value in entry.items():
            good = isinstance(value, bool) if key == "fixed" else _is_number(value)
            if key not in ("nominal", "lower", "upper", "fixed") or not good:
                raise InputError(
                    f"Entry '{key}' of parameter {name} must be nominal, lower, upper (numbers in SI) or "
                    f"fixed (true or false); instead received {key} = {value!r}."
                )
        fixed = entry.pop("fixed", False)
        if name in nominal:
            start = entry.get("nominal", nominal[name].nominal)
            if fixed:
                entry |= {"nominal": start, "lower": start, "upper": start}
            low, high = entry.get("lower", nominal[name].lower), entry.get("upper", nominal[name].upper)
            if ("lower" in entry or "upper" in entry) and not low <= start <= high:
                raise InputError(
                    f"Bounds {low:g} to {high:g} of parameter {name} exclude its start {start:g}; "
                    "widen them or give another 'nominal'."
                )
        out[name] = entry
    return out


def _is_number(value: Any) -> bool:
    """Whether a value is a number, or the infinity of a bound that is none."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and (abs(value) <= MOST_NUMBER or abs(value) == float("inf"))
