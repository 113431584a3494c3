"""Effects by what is typed and saved: `hysteresis:half_width_m=6e-05`, a name and its numbers.

A diagnosis names an effect and prints the text that `--effect` takes; a calibration holds the same text, so
the model can be built again. Numbers that a log must tell first (a width, an instant, a frequency) have no
default: `hallsym.diagnosis.choose` finds them when only the name is given.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from hallsym.errors import InputError, nearest
from hallsym.families.parts import Make
from hallsym.families.rotary import recipes as rotary_recipes
from hallsym.families.stage import recipes as stage_recipes
from hallsym.model import Model

REPAIR = "is a fault of the recording, which no model holds"
FAULTS = {
    "outliers": f"{REPAIR}: fit with --loss auto or tukey, which leave spikes out or weigh them down.",
    "dropped_samples": f"{REPAIR}: repair the acquisition, or leave the samples out (--loss tukey).",
    "clock_jitter": f"{REPAIR}: take readings and reference on one clock, and record again.",
    "adc_quantisation": f"{REPAIR}: use a finer range or converter; the fit counts step / sqrt(12) as noise.",
    "cordic_steps": f"{REPAIR}: let the chip take more steps, or take its raw voltages; an angle stands for "
    "a range of angles, so that no correction takes more than a few percent off.",
    "channel_swap": f"{REPAIR}: put the wiring right, or fit with --resolve-wiring.",
    "sign_inversion": f"{REPAIR}: put the wiring right, or fit with --resolve-wiring.",
}
"""Names that a diagnosis may give and no fit can add, with what to do instead."""


RECIPES: Mapping[str, Mapping[str, tuple[Callable[..., Make], ...]]] = {
    "stage": stage_recipes.RECIPES,
    "rotary": rotary_recipes.RECIPES,
}
"""By family and name; where an effect has several forms the numbers that are given tell them apart."""


def recipes_of(family: str) -> Mapping[str, tuple[Callable[..., Make], ...]]:
    """Return the effects with a text that a family of sensors has; none for one that is not known here."""
    return RECIPES.get(family, {})


def write(family: str, name: str, **numbers: object) -> str:
    """Return the text of an effect: `write("stage", "mains_hum", frequency_hz=50.02)`; numbers to 9 digits.

    What the name alone already means is left out.
    """
    usual = {k: v.default for make in RECIPES[family][name] for k, v in _arguments(make).items()}
    said = ",".join(f"{k}={_written(v)}" for k, v in numbers.items() if v != usual[k])
    return f"{name}:{said}" if said else name


def _written(value: object) -> str:
    if isinstance(value, list | tuple):
        return "/".join(_written(v) for v in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def read(text: str) -> tuple[str, dict[str, str]]:
    """Return name and numbers of an effect's text. Raises `InputError` for another form."""
    name, colon, rest = text.partition(":")
    pairs = [part.partition("=") for part in rest.split(",")] if colon else []
    if not name or any(not key or not value for key, _, value in pairs):
        raise InputError(
            f"Effect {text!r} must be a name, or a name with its numbers: hysteresis:half_width_m=6e-05."
        )
    return name, {key.strip(): value.strip() for key, _, value in pairs}


def lacking(text: str, family: str) -> tuple[str, ...]:
    """Return the numbers that a known effect's text leaves open and that a log must tell."""
    name, given = read(text)
    forms = recipes_of(family).get(name, ())
    if not forms:
        return ()
    open_ = [[k for k, v in _arguments(f).items() if v.default is v.empty and k not in given] for f in forms]
    return tuple(sorted(open_, key=lambda names: len(names))[0])


def make_of(text: str) -> Make:
    """Return the effect that a text names: a function `Model -> Model` that notes the text in the model.

    A name that several families have means what it means in the family of the model it is applied to.
    Raises `InputError`, when it is applied, for numbers that are unknown, missing or no numbers.
    """
    name, given = read(text)

    def made(model: Model) -> Model:
        form = _form(name, RECIPES[model.family.name][name], given)
        wide = form(**_numbers(name, form, given))(model)
        return noted(model, model.family.short(wide), text)

    return lambda model: model.remember(("effect", text), lambda: made(model))


def noted(model: Model, wide: Model, text: str) -> Model:
    """Return `wide` with `text` as what its effects beyond those of `model` are saved as."""
    new = [effect for effect in wide.effects if effect not in model.effects]
    return replace(wide, texts={**wide.texts, **dict.fromkeys(new, text)})


def _arguments(make: Callable[..., Make]) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(make).parameters


def _form(name: str, forms: Sequence[Callable[..., Make]], given: Mapping[str, Any]) -> Callable[..., Make]:
    """Return the form of an effect that takes the numbers given."""
    known = list(dict.fromkeys(k for f in forms for k in _arguments(f)))
    for key in given:
        if key not in known:
            listed = f"; it has {', '.join(known)}" if known else "; it has none"
            raise InputError(f"Effect {name} has no number {key!r}{listed}{nearest(key, known)}.")
    fitting = [f for f in forms if set(given) <= set(_arguments(f))]
    if not fitting:
        raise InputError(f"Numbers {', '.join(given)} of effect {name} exclude each other; give one form.")
    whole = [f for f in fitting if all(k in given for k, v in _arguments(f).items() if v.default is v.empty)]
    if not whole:
        missing = [k for k, v in _arguments(fitting[0]).items() if v.default is v.empty and k not in given]
        raise InputError(
            f"Effect {name} needs {' and '.join(missing)}: {name}:{missing[0]}=..., as 'hallsym diagnose' "
            "prints it; with a log to fit, the name alone is enough."
        )
    return whole[0]


def _numbers(name: str, form: Callable[..., Make], given: Mapping[str, str]) -> dict[str, Any]:
    kinds = _arguments(form)
    out: dict[str, Any] = {}
    for key, text in given.items():
        kind = kinds[key].annotation
        try:
            out[key] = tuple(float(v) for v in text.split("/")) if kind is tuple else kind(text)
        except ValueError:
            wanted = {float: "a number", int: "a whole number", tuple: "numbers such as 1/2/3"}[kind]
            raise InputError(f"Number {key} of effect {name} must be {wanted}; it is {text!r}.") from None
    return out
