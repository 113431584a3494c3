"""Data-only functions that gains and offsets may follow, each as `(columns, read)`: time, temperature."""

from collections.abc import Callable, Sequence

import casadi as ca

from hallsym.computed import Computed, campaign_time
from hallsym.model import Model, Signals

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
