"""The arguments of an effect: meaning, allowed values, and values that a diagnosis tries."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from inspect import Parameter as Argument
from typing import Any, get_args, get_origin

import numpy as np

from hallsym.errors import InputError
from hallsym.model.model import Model

REQUIRED = Argument.empty
"""Default of a number that must be estimated from a log."""


@dataclass(frozen=True, eq=False)
class Facts:
    """Properties of a log from which numbers of effects follow: length, temperature, readings and residuals.

    `duration_s`: of the campaign. `temperature`: mean logged temperature [degC], None where none is
    logged. `extremes`: quantiles of each reading, (n_quantiles, n_channels), high and low in turn.
    `rails`: lowest and highest value of each channel where it repeats, else -inf and inf. `lines_hz`:
    mains frequencies seen in the residuals, of `lines_tried` independent ones. `instants`: channel and
    time [s] of a possible slip, of `instants_tried` that were compared, and times between which it lies.
    `on_runs`: runs in which an external field may have been on, of `on_runs_tried` choices.
    """

    duration_s: float
    columns: tuple[str, ...]
    temperature: float | None = None
    extremes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    rails: tuple[tuple[float, float], ...] = ()
    lines_hz: tuple[float, ...] = ()
    lines_tried: int = 1
    instants: tuple[tuple[int, float, float, float], ...] = ()
    instants_tried: int = 1
    on_runs: tuple[int, ...] = ()
    on_runs_tried: int = 1


def example_facts(model: Model) -> Facts:
    """Return the facts of a typical log of `model`, for examples and tests."""
    rails = [0.8 if c.endswith("_v") else 2e-4 for c in model.channels]
    return Facts(
        duration_s=60.0,
        columns=(*model.channels, *model.references, *model.state, "t_s", "temperature_degc"),
        temperature=22.0,
        rails=tuple((-v, v) for v in rails),
        lines_hz=(50.02,),
        instants=((0, 30.0, 30.0, 30.0),),
        on_runs=(1, 3),
    )


@dataclass(frozen=True, eq=False)
class Try:
    """Values of numbers that a diagnosis tries together; fields as in `Variant`."""

    numbers: Mapping[str, Any]
    label: str = ""
    shapes: int = 0
    tried: int = 1


@dataclass(frozen=True)
class Valid:
    """A condition that a number must meet, and how a message states it."""

    holds: Callable[[Any], bool]
    words: str


ANY = Valid(lambda value: True, "")
POSITIVE = Valid(lambda value: 0 < value < np.inf, "a positive number")
SHARE = Valid(lambda value: 0 < value < 1, "a number between 0 and 1")

Tries = Callable[[str, Model, Facts], Iterable[Try]]
"""`(name, model, facts)`: the values that a diagnosis tries for the number of that name."""


@dataclass(frozen=True, eq=False)
class Number:
    """An argument of an effect: meaning, allowed values, and values that a diagnosis tries.

    `choices`: the allowed values and their meanings. `instead`: the number belongs to a second form of the
    effect, an alternative to the numbers without this mark. `grid`: the values are nodes between which it may
    lie.
    """

    meaning: str
    tries: Tries
    default: Any = REQUIRED
    choices: Mapping[Any, str] = field(default_factory=dict)
    valid: Valid = ANY
    instead: bool = False
    grid: bool = False
    kind: Any = float

    def read(self, what: str, text: str) -> Any:
        """Return the value that a text states for this number, called `what` in messages."""
        several, kind = get_origin(self.kind) is tuple, (get_args(self.kind) or (self.kind,))[0]
        try:
            values = [_whole(v) if kind is int else kind(v) for v in (text.split("/") if several else [text])]
        except ValueError:
            whole = "whole " if kind is int else ""
            wanted = f"{whole}numbers such as 1/2/3" if several else f"a {whole}number"
            raise InputError(f"{what} ({self.meaning}) must be {wanted}; it is {text!r}.") from None
        if self.choices and values[0] not in self.choices:
            raise InputError(f"{what} must be one of {', '.join(map(str, self.choices))}; it is {text!r}.")
        if not all(map(self.valid.holds, values)):
            raise InputError(f"{what} must be {self.valid.words}; it is {text}.")
        return tuple(values) if several else values[0]


def _whole(text: str) -> int:
    value = float(text)
    if value != int(value):
        raise ValueError(text)
    return int(value)


def always(value: Any, model: Model, facts: Facts) -> bool:
    """Return True: a value that is tried on every log."""
    return True


def one_of(
    labels: Mapping[Any, str],
    meaning: str,
    *,
    default: Any = None,
    valid: Valid | None = None,
    when: Callable[[Any, Model, Facts], bool] = always,
) -> Any:
    """Return an argument with few choices, each with its label; the first is the default if none is stated.

    `valid`: condition on other values, which are accepted but not tried by a diagnosis. `when(value, model,
    facts)`: whether a choice is tried.
    """

    def tries(name: str, model: Model, facts: Facts) -> list[Try]:
        return [Try({name: value}, label) for value, label in labels.items() if when(value, model, facts)]

    usual = next(iter(labels)) if default is None else default
    return Number(meaning, tries, usual, {} if valid else labels, valid or ANY, kind=type(usual))


def searched(
    values: Sequence[Any] | Callable[[Facts], Sequence[Any]],
    meaning: str,
    *,
    label: str | Callable[[Any], str],
    default: Any = REQUIRED,
    valid: Valid = POSITIVE,
    instead: bool = False,
    shapes: int = 0,
    tried: Callable[[Facts], int] | None = None,
    grid: bool = False,
    when: Callable[[Any, Model, Facts], bool] = always,
) -> Any:
    """Return an argument that is searched over `values`, or over `values(facts)` of a log.

    `label`: a format or a function of the value. `tried(facts)`: how many values were compared, by
    default those of a grid. `grid`: the values are nodes between which it may lie.
    """

    def one(name: str, value: Any, count: int) -> Try:
        text = label(value) if callable(label) else label.format(value)
        return Try({name: value}, text, shapes, count)

    def tries(name: str, model: Model, facts: Facts) -> list[Try]:
        each = values(facts) if callable(values) else values
        count = tried(facts) if tried else 1 if callable(values) else len(each)
        return [one(name, v, count) for v in each if when(v, model, facts)]

    return Number(meaning, tries, default, valid=valid, instead=instead, grid=grid)


def from_log(value: Callable[[Facts], Any], meaning: str, *, valid: Valid = ANY) -> Any:
    """Return an argument that follows from a log: `value(facts)`."""
    return Number(meaning, lambda name, model, facts: [Try({name: value(facts)})], valid=valid)


def found(
    rule: Callable[[Model, Facts], Iterable[Try]],
    meaning: str,
    *,
    default: Any = REQUIRED,
    valid: Valid = ANY,
    instead: bool = False,
) -> Any:
    """Return an argument whose trials a rule finds on a log; these may set other numbers (see `beside`)."""
    return Number(
        meaning, lambda name, model, facts: rule(model, facts), default, valid=valid, instead=instead
    )


def beside(meaning: str, *, default: Any = REQUIRED, instead: bool = False) -> Any:
    """Return an argument that is set by the trials of another one."""
    return Number(meaning, lambda name, model, facts: [Try({})], default, instead=instead)
