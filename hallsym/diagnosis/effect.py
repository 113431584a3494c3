"""What an effect is to the diagnosis: a name, its link, and the ways in which it may act."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from hallsym.model import Model


@dataclass(frozen=True, eq=False)
class Facts:
    """What effects may know of a log before they are tried: its length, temperature, readings, hum.

    `duration_s`: of the campaign. `temperature`: mean logged temperature, None where none is logged.
    `extremes`: quantiles of each reading, (n_quantiles, n_channels). `rails`: lowest
    and highest value of each channel where it repeats, else -inf and inf. `lines_hz`: mains frequencies seen
    in the residual. `instants`: probe and moment [s] at which it may have slipped. `step_s`: sampling
    interval. `gains`: of the probes at rest. `instants_tried`: moments that were compared to find those.
    """

    duration_s: float
    step_s: float
    columns: tuple[str, ...]
    temperature: float | None = None
    extremes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    rails: tuple[tuple[float, float], ...] = ()
    lines_hz: tuple[float, ...] = ()
    instants: tuple[tuple[int, float], ...] = ()
    instants_tried: int = 1
    gains: tuple[float, ...] = ()
    on_runs: tuple[int, ...] = ()
    """Runs in which an external field may have been on, `switching.switched_runs`."""


@dataclass(frozen=True, eq=False)
class Variant:
    """One way in which an effect may act: `make(model) -> model`, new parameters at 0 for no effect.

    `label` tells variants of an effect apart; `shapes` counts numbers that were searched to get here (a
    width, an instant, a frequency) and are not among the parameters of the model.
    """

    label: str
    make: Callable[[Model], Model]
    shapes: int = 0
    shape: float | None = None
    tried: int = 1
    """Values of those numbers that were compared, for the significance."""
    text: str = ""
    """What `--effect` takes for it: name and numbers (`hallsym.families.recipes`); empty if it has none."""


@dataclass(frozen=True, eq=False)
class Effect:
    """A named cause of a gap.

    `needs`: logged columns without which it cannot be tested. `variants(model, facts)`: from plain to
    general. `refine(model, facts, shape)`: finer variants around a searched shape. `record`: what to record
    so that it shows by itself. `possible`: whether fitted parameters are such as this cause can have; what
    fits with others is another cause's.
    """

    name: str
    link: str
    meaning: str
    variants: Callable[[Model, Facts], list[Variant]]
    record: str
    needs: tuple[str, ...] = ()
    refine: Callable[[Model, Facts, float], list[Variant]] | None = None
    possible: Callable[[Mapping[str, float]], bool] = lambda values: True
