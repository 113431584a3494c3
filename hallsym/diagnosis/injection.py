"""Readings of a machine whose gap is known: an effect or fault, scaled until the gap is as wanted.

An effect acts through its own model (`injection_catalogue`), exactly; a fault of samples acts on the readings
(`injection_faults`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from hallsym.diagnosis.simulated_machine import Truth
from hallsym.diagnosis.words import gap_text, gap_unit

ABSORBED = 0.02
"""Share of an effect that must be left by the model's own parameters for it to count as visible."""
NEAR = 0.02
"""How near the gap of an injection must come to what is wanted."""
SEARCH = 12
Size = dict[str, tuple[float, str]]
"""Parameter -> value in SI, unit."""
Noisy = np.ndarray | float
"""Noise of the readings, (K, rows), or 0."""


@dataclass(frozen=True, eq=False)
class Injection:
    """An effect or a fault that can be given any size.

    `make(amount, noise) -> readings`: (K, rows), `noise` alike or 0. `size(amount)`: its parameters. `most`:
    amount beyond which it is no longer what its name says. `start`: an amount to begin the search from.
    `sized`: False where there is nothing to scale (an exchanged channel).
    """

    name: str
    link: str
    form: str
    make: Callable[[float, Noisy], np.ndarray]
    size: Callable[[float], Size]
    most: float
    start: float = 1.0
    sized: bool = True


@dataclass(frozen=True)
class Sized:
    """How large an injection must be for a gap: `reason` says why there is no such amount."""

    amount: float
    gap_m: float
    reason: str = ""


def sized(truth: Truth, injection: Injection, ratio: float) -> Sized:
    """Scale an injection until its noise-free gap with the floor is `ratio` times the floor."""
    wanted = truth.floor_m * float(np.sqrt(ratio**2 - 1))
    amount, slope, seen = min(injection.start, injection.most), 1.0, [(0.0, 0.0)]
    for _ in range(SEARCH):
        readings = injection.make(amount, 0.0)
        if not np.isfinite(readings).all():
            return Sized(amount, 0.0, "its readings are not finite on this log")
        gap, raw = truth.gap(readings)
        hidden = gap < ABSORBED * raw and raw > truth.floor_m
        if hidden or (amount >= injection.most and gap < (1 - NEAR) * wanted):
            return Sized(amount, gap, _invisible(gap, raw, gap_unit(truth.base.model.pose)))
        before = seen[-1]
        seen.append((amount, gap))
        if abs(gap / wanted - 1) < NEAR:
            break
        if min(gap, *before) > 0 and before[0] != amount:
            slope = float(np.log(gap / before[1]) / np.log(amount / before[0]))
        factor = (wanted / gap) ** (1 / np.clip(slope, 0.4, 4.0)) if gap > 0 else 10.0
        amount = float(min(amount * np.clip(factor, 0.02, 50.0), injection.most))
    return Sized(*min(seen[1:], key=lambda s: abs(s[1] - wanted)))


def _invisible(gap: float, raw: float, unit: tuple[float, str]) -> str:
    left = gap_text(gap, unit, 2)
    if gap < ABSORBED * raw:
        return f"the model's own parameters absorb it: of {gap_text(raw, unit)} they leave {left}"
    return f"at the bounds of its parameters it makes {left} on this log"


def generator(seed: int, *names: str | int) -> np.random.Generator:
    """Return a generator that depends on the names only, so that leaving effects out changes no draw."""
    return np.random.default_rng([seed, *(crc32(str(n).encode()) for n in names)])
