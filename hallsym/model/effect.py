"""An effect: one function `Model -> Model` whose signature defines it for the rest of the program.

    @effect(link="field", meaning="memory of the direction of motion",
            separate=Way("the same stroke at several speeds", "a loop keeps its width, a delay does not"))
    def hysteresis(model: Model, half_width_m: float = searched((2e-6, 2e-5, 2e-4), "half-width of the
    loop")): ...

The signature is what `--effect hysteresis:half_width_m=6e-05` takes, what a calibration saves, what a
diagnosis tries on a log and what the detection power injects. A name ends with the unit of its number. The
default of a number states the source of its value: `one_of` several choices, `searched` on a grid,
`from_log`, `found` by a rule (several numbers at once), or a plain value.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from types import NoneType
from typing import Any, get_args

from hallsym.errors import InputError, nearest, require
from hallsym.model.arguments import REQUIRED, Facts, Number, Try
from hallsym.model.model import LINKS, Model


@dataclass(frozen=True, eq=False)
class Variant:
    """One way in which an effect may act: `make(model) -> model`, new parameters at 0 for no effect.

    `label` names the variant within its effect; `text` is the argument of `--effect`, `numbers` its values.
    `shapes` counts searched numbers that are no parameters of the model, `tried` how many of their values
    were compared, for the significance.
    """

    label: str
    make: Callable[[Model], Model]
    text: str
    numbers: Mapping[str, Any]
    shapes: int = 0
    tried: int = 1


# -- effects -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Way:
    """A recording that isolates an effect: `what` to record, and the `reason`, if stated."""

    what: str
    reason: str = ""


def ways_text(ways: Iterable[Way]) -> str:
    """Return ways to record in words, each once with all of its reasons.

    >>> ways_text([Way("another air gap"), Way("long runs"), Way("another air gap", "it follows the field")])
    'another air gap: it follows the field; or long runs'
    """
    reasons: dict[str, dict[str, None]] = {}
    for way in ways:
        reasons.setdefault(way.what, {}).update({way.reason: None} if way.reason else {})
    return "; or ".join(f"{what}: {', '.join(why)}" if why else what for what, why in reasons.items())


@dataclass(frozen=True, eq=False)
class Effect:
    """A named cause of a model error; `effect(model, **numbers)` returns the model with it.

    `link`: of the chain from pose to reading. `separate`: recordings that isolate it. `needs`: logged columns
    that a test of it requires. `label`: of a variant without numbers. `unless`: effects that contain it.
    `waves`: waves of error per period of the pose that it causes. `possible(values)`: whether fitted
    parameters can belong to this cause. `remark(values, stds)`: what a user must know of them, or nothing;
    an uncertainty is infinite where unknown. `inject`: how it is injected, if not by its parameters.
    `diagnosed`: whether a diagnosis tries it.
    """

    name: str
    link: str
    meaning: str
    function: Callable[..., Model]
    numbers: Mapping[str, Number]
    separate: tuple[Way, ...] = (Way("a recording that moves what it depends on"),)
    needs: tuple[str, ...] = ()
    label: str = "as given"
    unless: tuple[str, ...] = ()
    waves: tuple[int, ...] = ()
    possible: Callable[[Mapping[str, float]], bool] = lambda values: True
    remark: Callable[[Mapping[str, float], Mapping[str, float]], str] = lambda values, stds: ""
    inject: Callable[..., Any] | None = None
    diagnosed: bool = True

    def __call__(self, model: Model, **numbers: Any) -> Model:
        """Return `model` with the effect; numbers count to the 9 digits that a calibration saves."""
        return self.added(model, self.text(**numbers))

    # -- texts -----------------------------------------------------------------------------------------------

    def text(self, **numbers: Any) -> str:
        """Return what `--effect` takes: name and numbers to 9 digits, without those that the name implies."""
        ordered = sorted(numbers, key=[*self.numbers, *numbers].index)
        usual = {name: number.default for name, number in self.numbers.items()}
        said = ",".join(
            f"{n}={_written(numbers[n])}" for n in ordered if numbers[n] != usual.get(n, REQUIRED)
        )
        return f"{self.name}:{said}" if said else self.name

    def added(self, model: Model, text: str) -> Model:
        """Return `model` with the effect as a text states it; made once for each model and text.

        Raises `InputError` for numbers that are unknown, missing or out of range.
        """

        def made() -> Model:
            wide = self.function(model, **self.values(text))
            if not isinstance(wide, Model):
                raise InputError(
                    f"Effect {self.name} must return a Model; instead it returned {type(wide).__name__}."
                )
            wide = wide.family.short(wide)
            new = [effect for effect in wide.effects if effect not in model.effects]
            return replace(wide, texts={**wide.texts, **dict.fromkeys(new, text)})

        return model.remember((self, text), made)

    def values(self, text: str) -> dict[str, Any]:
        """Return the numbers that a text states or implies; None for those of the form that it does not
        take."""
        _, given = read_text(text)
        names = self._form(text, given)
        stated = {n: self.numbers[n].read(f"Number {n} of effect {self.name}", v) for n, v in given.items()}
        return {n: stated.get(n, k.default) if n in names else None for n, k in self.numbers.items()}

    def lacking(self, text: str) -> tuple[str, ...]:
        """Return the numbers that a text leaves open and that must be estimated from a log."""
        _, given = read_text(text)
        return min((self._open(names, given) for names in self.forms), key=len)

    @property
    def forms(self) -> tuple[tuple[str, ...], ...]:
        """Names of the numbers that go together: of the first form, and of the second one if there is one."""
        first = tuple(n for n, number in self.numbers.items() if not number.instead)
        second = tuple(n for n, number in self.numbers.items() if number.instead)
        return tuple(names for names in (first, second) if names) or ((),)

    def _open(self, names: Sequence[str], given: Mapping[str, str]) -> tuple[str, ...]:
        return tuple(n for n in names if self.numbers[n].default is REQUIRED and n not in given)

    def _form(self, text: str, given: Mapping[str, str]) -> tuple[str, ...]:
        """The form of the effect that takes the numbers given."""
        for name in given:
            if not self.numbers:
                raise InputError(f"Effect {self.name} takes no numbers; instead received {text!r}.")
            if name not in self.numbers:
                known = list(self.numbers)
                said = f"has no number {name!r}; it has {', '.join(known)}{nearest(name, known)}."
                raise InputError(f"Effect {self.name} {said}")
        fitting = [names for names in self.forms if set(given) <= set(names)]
        if not fitting:
            raise InputError(
                f"Numbers {', '.join(given)} of effect {self.name} exclude each other; give one form."
            )
        whole = [names for names in fitting if not self._open(names, given)]
        if not whole:
            missing = self._open(fitting[0], given)
            raise InputError(
                f"Effect {self.name} needs {' and '.join(missing)}: {self.name}:{missing[0]}=..., as "
                "'hallsym diagnose' prints it; with a log to fit, the name alone is enough."
            )
        return whole[0]

    # -- what a diagnosis tries ------------------------------------------------------------------------------

    def variants(self, model: Model, facts: Facts) -> list[Variant]:
        """Return what a diagnosis tries on a log, form by form; the last number varies fastest."""
        if set(self.unless) & set(model.effects):
            return []
        out = []
        for names in self.forms:
            tried = [list(self.numbers[n].tries(n, model, facts)) for n in names]
            out += [self._variant(tries) for tries in product(*tried)]
        return out

    def _variant(self, tries: Sequence[Try]) -> Variant:
        numbers = {name: value for t in tries for name, value in t.numbers.items()}
        text = self.text(**numbers)
        return Variant(
            label="".join(t.label for t in tries) or self.label,
            make=lambda model: self.added(model, text),
            text=text,
            numbers=numbers,
            shapes=sum(t.shapes for t in tries),
            tried=prod(t.tried for t in tries),
        )


Decorated = Callable[[Callable[..., Model]], Effect]


def effect(
    *,
    link: str,
    name: str = "",
    meaning: str = "",
    separate: str | Way | Sequence[str | Way] = (),
    numbers: Mapping[str, Number] | None = None,
    **about: Any,
) -> Decorated:
    """Make a function `Model -> Model` an `Effect`; `about`: the fields of the record that are not usual.

    Name, meaning and numbers are those of the function, of the first line of its docstring and of its
    signature if they are not stated. `separate`: one recording that isolates it, or several.
    """
    require(link in (*LINKS, "user"), "Link of an effect", f"one of {', '.join(LINKS)}", link)
    each = (separate,) if isinstance(separate, str | Way) else separate
    if each:
        about["separate"] = tuple(Way(way) if isinstance(way, str) else way for way in each)

    def decorate(function: Callable[..., Model]) -> Effect:
        called = name or function.__name__
        first = (function.__doc__ or "").strip().split("\n")[0]
        own = _numbers(called, function) if numbers is None else numbers
        return Effect(called, link, meaning or first, function, own, **about)

    return decorate


def as_effect(function: Callable[..., Model]) -> Effect:
    """Return a plain function `Model -> Model` as an effect; an `Effect` as it is."""
    return function if isinstance(function, Effect) else effect(link="user")(function)


def _numbers(name: str, function: Callable[..., Model]) -> dict[str, Number]:
    """The declared arguments, and plain defaults that a text can state: numbers and words."""
    arguments = list(inspect.signature(function).parameters)[1:]
    known = inspect.signature(function, eval_str=bool(arguments)).parameters
    out = {}
    for key in arguments:
        usual, stated = known[key].default, known[key].annotation
        if usual is REQUIRED:
            raise InputError(
                f"Argument {key} of effect {name} must have a default, such as searched(...) or a number."
            )
        if not isinstance(usual, Number):
            if type(usual) in (int, float, str):
                out[key] = Number(key, lambda *_: [Try({})], usual, kind=type(usual))
            continue
        if stated is REQUIRED:
            stated = type(next(iter(usual.choices), 0.0))
        kinds = (
            [k for k in get_args(stated) if k is not NoneType] if NoneType in get_args(stated) else [stated]
        )
        out[key] = replace(usual, kind=kinds[0])
    return out


def read_text(text: str) -> tuple[str, dict[str, str]]:
    """Return name and numbers of an effect's text. Raises `InputError` for another form."""
    name, colon, rest = text.partition(":")
    pairs = [part.partition("=") for part in rest.split(",")] if colon else []
    if not name or any(not key or not value for key, _, value in pairs):
        raise InputError(
            f"Effect {text!r} must be a name, or a name with its numbers: hysteresis:half_width_m=6e-05."
        )
    return name, {key.strip(): value.strip() for key, _, value in pairs}


def _written(value: object) -> str:
    if isinstance(value, list | tuple):
        return "/".join(_written(v) for v in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)
