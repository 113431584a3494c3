"""The kinds of sensor: one file per family, its effects beside it, only physics. Looked up here by name."""

from collections.abc import Callable, Collection, Mapping
from typing import Any

from hallsym.errors import InputError, nearest
from hallsym.families.faults import FAULTS
from hallsym.families.rotary import effects as rotary_effects
from hallsym.families.rotary import models as rotary
from hallsym.families.stage import effects as stage_effects
from hallsym.families.stage import models as stage
from hallsym.log import Meta
from hallsym.log.limits import is_moving
from hallsym.model import Effect, Model
from hallsym.model.effect import as_effect, read_text

FAMILIES = (stage, rotary)
"""Adding a family: one file with MODELS, EFFECTS, ALIASES and `from_meta`, and its name here."""
EFFECTS = {stage.FAMILY: stage_effects.EFFECTS, rotary.FAMILY: rotary_effects.EFFECTS}
"""Effects by family."""


def models() -> dict[str, Callable[..., Model]]:
    """Return every model by name, aliases included."""
    named = {make.__name__: make for family in FAMILIES for make in family.MODELS}
    return named | {alias: named[name] for family in FAMILIES for alias, name in family.ALIASES.items()}


def effects(family: str | None = None) -> dict[str, Effect]:
    """Return every effect by name: of one family, or of all."""
    return {e.name: e for name, known in EFFECTS.items() if family in (None, name) for e in known}


def known_effect(text: str) -> bool:
    """Return whether an effect, named with or without numbers, is one of hallsym's own."""
    return read_text(text)[0] in effects()


def build(
    name: str,
    *,
    meta: Meta | None = None,
    added: tuple[str, ...] = (),
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
    own: Mapping[str, Callable[[Model], Model]] | None = None,
) -> Model:
    """Return the model called `name` for the machine that `meta` describes.

    `meta`: probe layout and nominal values of a log folder. `added`: effects by name, with their numbers
    where they have some (`hallsym.model.effect`). `parameters`: changed nominal values and bounds,
    `{"H1x": {"lower": .1}}`. `own`: the user's effects by name. Raises `InputError` that lists known names.
    """
    known = models()
    if name not in known:
        raise _unknown("Model", name, known)
    family = next(f for f in FAMILIES if known[name] in f.MODELS)
    return adapted(family.from_meta(known[name], meta or Meta()), added, parameters or {}, own)


def default_model(meta: Meta) -> str:
    """Return the model where none is named: the log's own, else that of the family whose columns it has.

    Raises `InputError` where the columns are of no family.
    """
    if meta.columns and not meta.base_model and not any(map(is_moving, meta.columns)):
        raise InputError(
            f"The log's columns ({', '.join(meta.columns)}) are neither a stage (hall_a_m, ..., x_ref_m) "
            "nor an encoder (v_sin_v and v_cos_v, or angle_rad; angle_ref_rad); map columns with --column, "
            "or name the model with --model."
        )
    fitting = (f.DEFAULT for f in FAMILIES if f.reads(meta.columns))
    return meta.base_model or next(fitting, FAMILIES[0].DEFAULT)


def axes() -> tuple[str, ...]:
    """Return every coordinate and state that a campaign can move."""
    return tuple(dict.fromkeys(axis for f in FAMILIES for axis in (*f.POSE, *f.STATE)))


def model_for(moved: Collection[str]) -> str:
    """Return the model to simulate where none is named: that of the first family with the axes moved."""
    fitting = (f.DEFAULT for f in FAMILIES if {*f.POSE, *f.STATE}.issuperset(moved))
    return next(fitting, FAMILIES[0].DEFAULT)


def example(model: Model) -> Mapping[str, Any]:
    """Return what is simulated of a family by default: campaign, values and noise; may be empty."""
    family = next((f for f in FAMILIES if model.family == f.FAMILY), None)
    return getattr(family, "EXAMPLE", {})


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

    A model of no family here has no plain form and is returned as it is.
    """
    known = models()
    if model.name not in known:
        return model
    base = known[model.name](model.layout)
    mine = {p.name: p for p in (*model.parameters, *model.zeros)}
    kept = [mine[p.name] for p in (*base.parameters, *base.zeros) if p.name in mine]
    return base.with_parameters(
        {p.name: {"nominal": p.nominal, "lower": p.lower, "upper": p.upper} for p in kept}
    )


def same_layout(model: Model, meta: Meta) -> bool:
    """Return whether a log's `meta.json` describes the machine of `model`, or none."""
    if meta.probes is None:
        return True
    family = next(f for f in FAMILIES if model.family == f.FAMILY)
    return family.from_meta(models()[model.name], meta).layout == model.layout


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
        others = [family for family in EFFECTS if name in effects(family)]
        if others:
            raise InputError(
                f"Effect {name} belongs to {' and '.join(others)} models; model {model.name} is of family "
                f"{model.family}."
            )
        raise _unknown("Effect", name, known)
    return known[name]


def _unknown(what: str, name: str, known: Mapping[str, Any]) -> InputError:
    listed = ", ".join(known)
    return InputError(
        f"{what} must be one of {listed}; instead received {name!r}{nearest(name, list(known))}."
    )


def _checked(model: Model, changes: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Turn `fixed = true` into equal bounds and refuse bounds that exclude the start the user gave."""
    nominal = {p.name: p for p in (*model.parameters, *model.zeros)}
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


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value
