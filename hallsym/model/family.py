"""A family of sensors: one record with everything that shared code needs to know about it.

Shared code uses the record that a `Model` carries, never a name, so families outside the package are equal to
hallsym's own: only text input (the name of a model, a saved calibration) needs a look-up.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from hallsym.errors import InputError, summary

Model = Any
"""`hallsym.model.Model`, which holds its family."""
Effect = Any
"""`hallsym.model.Effect`, which acts on a model."""
Maker = Callable[..., Model]
"""`maker(layout=None) -> Model`; its name is the model's."""


@dataclass(frozen=True)
class PoseMetric:
    """How an error of the pose becomes one number in `unit` ("m" or "rad").

    `arm_m` turns rotation into length and back; a log may state another (`gap_length_scale_m`).
    """

    unit: str = "m"
    arm_m: float = 0.35

    def weights(self, columns: Iterable[str], arm_m: float | None = None) -> np.ndarray:
        """Return the factor on the error of each pose coordinate or reference, (n,).

        The metric of several coordinates is the root of the summed squares of these products.

        >>> PoseMetric("m", 0.5).weights(("x_m", "rz_ref_rad"))
        array([1. , 0.5])
        """
        arm = self.arm_m if arm_m is None else arm_m
        factor = {("m", "rad"): arm, ("rad", "m"): 1.0 / arm}
        return np.array([factor.get((self.unit, c.rpartition("_")[2]), 1.0) for c in columns])


@dataclass(frozen=True, eq=False)
class Example:
    """Defaults of a simulation: tables of a campaign file, values and noise (1 sigma)."""

    campaign: Mapping[str, Any]
    values: Mapping[str, float]
    noise: Mapping[str, float]


def _itself(model: Model) -> Model:
    return model


@dataclass(frozen=True, eq=False)
class Further:
    """A further recording that a machine can make, for parameters that a log does not determine.

    `text`: what is recorded, in words. `moved(columns)`: those references of it that differ from the log's,
    from the columns of the log, (samples,) each. `read(model)`: the model as it reads in that recording,
    None where the machine cannot make it; parameters beyond the log's own, which come last, belong to this
    recording alone (a zero that is set anew).
    """

    text: str
    moved: Callable[[Mapping[str, np.ndarray]], Mapping[str, np.ndarray]] = lambda columns: {}
    read: Callable[[Model], Model | None] = _itself


def _plain_from_meta(make: Maker, meta: Any) -> Model:
    return make()


@dataclass(frozen=True, eq=False)
class Family:
    """What a family of sensors declares to the rest of the program.

    `models`: makers, `default` the name of one (the first), `aliases`: other name -> name. `readings`: a
    regular expression of its reading columns. `about`: a log of it in messages, such as "a beam (hall_a_m,
    ...; y_ref_m)"; `noun`: the machine in messages ("beam"). `from_meta(make, meta)`: the model for the
    layout, columns and nominal values that a log states. `decoder`: how its pose is computed in C, a kind
    that `hallsym.codegen` knows or a maker `(model, p, weight, box) -> Decoupler`.
    """

    name: str
    models: tuple[Maker, ...] = ()
    default: str = ""
    readings: str = r"(hall|col|v)_\w+"
    references: tuple[str, ...] = ()
    """Logged columns beside the pose, of all models; empty: those that its makers state."""
    moved: tuple[str, ...] = ()
    """Coordinates and states that a campaign can move, of all models; likewise."""
    about: str = ""
    noun: str = ""
    pose_metric: PoseMetric = PoseMetric()
    aliases: Mapping[str, str] = field(default_factory=dict)
    from_meta: Callable[[Maker, Any], Model] = _plain_from_meta
    tables: tuple[str, ...] = ()
    """Tables of a machine file and of meta.json that `from_meta` reads in `Meta.raw`, beside the probes."""
    effects: tuple[Effect, ...] = ()
    """Effects that a model may have; of two that are confusable a diagnosis prefers the first."""
    words: Mapping[str, str] = field(default_factory=dict)
    """Plain names of columns: `z_m` -> "height Z"."""
    assumed: str = ""
    """The layout that its models assume by default, as a note states it."""
    together: str = ""
    """Plain name of all state columns together."""
    example: Example | None = None
    tolerances: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Usual tolerances: effect as `--effect` takes it ("" for the models themselves) -> lines of a tolerance
    file, where `*` stands for any label: {"gain_mismatch": {"gain_*_percent": 2}}."""
    direct: Callable[[Model], Model] = _itself
    """The same model in the form that is cheapest to evaluate sample by sample."""
    short: Callable[[Model], Model] = _itself
    """The same model in a form that stays small with many effects; applied to each model with an effect."""
    pairs: bool = False
    """Whether a diagnosis compares a flexible effect with pairs of plain ones."""
    most_effects: int = 3
    """Effects that a diagnosis adds at most."""
    at_bounds: tuple[tuple[str, str, str], ...] = ()
    """Claims on parameters that end at their bounds: name, pattern of the parameters, what it means."""
    implausible: Callable[[Any], Iterable[Any]] = lambda fit: ()
    """Claims (`hallsym.log.Fault`) on a fit with values outside the plausible range of the family."""
    further: tuple[Further, ...] = ()
    """Further recordings that its machines can make."""
    decoder: str | Callable[..., Any] = "linear"

    @cached_property
    def catalogue(self) -> tuple[Effect, ...]:
        """Effects that a diagnosis searches."""
        return tuple(e for e in self.effects if e.diagnosed)

    @cached_property
    def waves(self) -> dict[int, tuple[str, ...]]:
        """Waves of the error per period of the first periodic coordinate -> effects that make them."""
        orders = sorted({n for e in self.effects for n in e.waves})
        return {n: tuple(e.name for e in self.effects if n in e.waves) for n in orders}

    def __str__(self) -> str:
        """Return the name, which messages use."""
        return self.name

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Coordinates and states that a campaign can move, of all models."""
        if self.moved:
            return self.moved
        own = [c for part in ("pose", "state") for m in self._models.values() for c in getattr(m, part)]
        return tuple(dict.fromkeys(own))

    @cached_property
    def _models(self) -> dict[str, Model]:
        """The models by name, without those whose maker fails: nobody may have asked for these."""
        made = {}
        for make in self.models:
            with suppress(InputError):
                made[make.__name__] = self.made(make)
        return made

    def made(self, call: Callable[..., Any], *given: Any) -> Any:
        """Return `call(*given)`, where `call` is this family's: a maker, an effect or `from_meta`.

        Raises `InputError` with one sentence for whatever it raises.
        """
        try:
            return call(*given)
        except InputError:
            raise
        except Exception as error:
            what = f"{type(error).__name__}: {summary(error)}"
            raise InputError(
                f"Family {self.name} cannot be used: its code fails ({what}); correct the family, or take "
                "a model of another one."
            ) from error

    def refers(self, columns: Collection[str]) -> bool:
        """Return whether a log with these columns has a reference that its models have."""
        first = self.references[:1] or [m.references[0] for m in self._models.values()]
        return any(c in columns for c in first)

    def reads(self, columns: Collection[str]) -> bool:
        """Return whether a log with these columns has such a reference and is read as this family is."""
        return any(re.fullmatch(self.readings, c) for c in columns) and self.refers(columns)

    def model_of(self, columns: Collection[str]) -> str:
        """Return the name of the model that has most references of a log, else the default."""
        first = self.default or self.models[0].__name__
        known = {} if self.references else {n: m.references for n, m in self._models.items()}
        fitting = {n: len(own) for n, own in known.items() if set(own) <= set(columns)}
        return max([first, *fitting], key=lambda n: fitting.get(n, 0))

    def maker(self, name: str) -> Maker | None:
        """Return the maker of the model called `name` or an alias of it; None where there is none."""
        name = self.aliases.get(name, name)
        return next((make for make in self.models if make.__name__ == name), None)
