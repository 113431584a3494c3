"""Data-only functions that gains and offsets may follow, as `(columns, read)`: of time, runs, temperature."""

from collections.abc import Callable, Sequence
from math import pi

import casadi as ca
import numpy as np

from hallsym.model import Model, Signals
from hallsym.model.derived import Computed, Stretch, campaign_time

Read = Callable[[Signals], list[ca.SX]]
"""Values of the functions, from the signals of a chain that has the columns."""
Columns = Sequence[str | Computed]
Followed = tuple[Columns, Read]


def count(model: Model, read: Read) -> int:
    """Return how many functions there are; `model` has their columns."""
    return len(read(Signals((*model.pose, *model.state))))


def powers_of_time(duration_s: float, degree: int) -> Followed:
    """Return shifted Legendre polynomials of campaign time, degrees 1 to `degree`."""

    def read(s: Signals) -> list[ca.SX]:
        x = 2 * s["campaign_s"] / duration_s - 1
        return [x, (3 * x**2 - 1) / 2, (5 * x**3 - 3 * x) / 2][:degree]

    return [campaign_time()], read


def settling(tau_s: float) -> Followed:
    """Return exp(-t / tau): the shape of a warm-up."""
    return [campaign_time()], lambda s: [ca.exp(-s["campaign_s"] / tau_s)]


def temperature(mean: float) -> Followed:
    """Return the logged temperature above its mean."""
    return ["temperature_degc"], lambda s: [s["temperature_degc"] - mean]


def during(runs: Sequence[int]) -> Followed:
    """Return 1 in some runs, 0 in the others."""
    name, on = f"on_in_{'_'.join(map(str, runs))}", frozenset(runs)

    def rule(s: Stretch) -> np.ndarray:
        return np.full(len(s.data["t_s"]), float(s.run in on))

    return [Computed(name, (), rule)], lambda s: [s[name]]


def wave_of_time(frequency_hz: float, harmonics: Sequence[int] = (1,)) -> Followed:
    """Return cosine and sine of a frequency and its harmonics over the campaign."""
    columns = []
    for k in harmonics:
        for name, function in (("cos", np.cos), ("sin", np.sin)):

            def rule(s: Stretch, f: float = k * frequency_hz, of: Callable = function) -> np.ndarray:
                return np.asarray(of(2 * pi * f * (s.data["t_s"] - s.origin_s)))

            columns.append(Computed(f"{name}_{k}x{frequency_hz:.9g}hz", (), rule))
    return columns, lambda s: [s[c.name] for c in columns]
