"""Steps of what is left of readings of a wave once its phasor is known: their contradiction.

Weighted least squares make a phasor of n readings; what its first harmonic leaves of them, P (r - offset)
with P = 1 - H of rank n - 2, is linear in the readings with constant entries. What the higher harmonics and a
tilt read of it is taken off by few terms, found by regression over poses of the box.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement as combined

import casadi as ca
import numpy as np

from hallsym.codegen import residual
from hallsym.codegen.decoupler import Collected, Redundancy, Watched
from hallsym.codegen.lowering.arrays_fit import fewest
from hallsym.codegen.lowering.phasors import Phasor
from hallsym.codegen.lowering.wave_steps import Pair, Powers

LEAVE = 0.5
"""Standard deviations of a reading, rms over poses, that terms may leave of it: what they leave at most
widens the limit of the fault."""
TILTS = 2
"""Highest power of rotations in a term."""
LOST = 1e-12
"""Offset [V] that is rounding of the analysis."""
EQUAL = 1e-9
"""Relative difference of standard deviations that is rounding."""
UNKNOWNS = 2
"""Of a phasor: its real and its imaginary part."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Readings of one wave: their numbers, their symbols by name, and those of the phasor."""

    numbers: tuple[int, ...]
    phasor: Phasor
    readings: Mapping[str, ca.SX]
    at: Pair
    tag: str = ""
    rounds: int = 0
    """Rounds that took off higher harmonics: powers of the last one stand for those of `at`, where given."""


def contradictions(
    made: Collected,
    waves: Sequence[Seen],
    sigma: np.ndarray,
    read: np.ndarray,
    tilts: Mapping[int, ca.SX] | None = None,
    tilted: np.ndarray | None = None,
    more: Callable[[], list[Watched]] = list,
) -> Redundancy | None:
    """Add what is left of all readings and the sum of its squares; None where nothing is left over.

    `sigma` (n,): standard deviation of each reading [V]; the sum is in units of the largest. `read` (n, s):
    readings at trial poses. `tilts`: symbols of rotations by number, `tilted` (3, s) of the trial poses.
    `more`: adds what else is left, where that may tell readings that otherwise cannot be.
    """
    watched: list[Watched] = []
    shapes = np.zeros((0, read.shape[1])) if tilted is None else tilted
    for wave in waves:
        if len(wave.numbers) > UNKNOWNS:
            watched += _Left(made, wave, sigma, read, tilts or {}, shapes).make()
    if not watched:
        return None
    if any(len(w.readings) > 1 for w in watched):
        watched += more()
    return residual.summed(made, watched)


class _Left:
    """What is left of the readings of one wave."""

    def __init__(
        self, made: Collected, wave: Seen, sigma: np.ndarray, read: np.ndarray, tilts: Mapping[int, ca.SX],
        tilted: np.ndarray,
    ) -> None:  # fmt: skip
        self.made, self.wave, self.tilts, self.tilted = made, wave, tilts, tilted
        own, self.read = sigma[list(wave.numbers)], read[list(wave.numbers)]
        self.u = wave.phasor.solved(self.read)
        self.scale, self.unit = sigma.max() / own, float(sigma.max())
        self.rows = wave.phasor.design().T
        self.powers = Powers(made, *wave.at, f"_of{wave.tag}")
        for n in wave.phasor.harmonics:
            real, imaginary = (f"{part}_{n}_{wave.rounds}{wave.tag}" for part in ("real", "imaginary"))
            if imaginary in made.symbols:
                self.powers.known[n] = made.symbols[real], made.symbols[imaginary]

    def make(self) -> list[Watched]:
        """Add the steps: one of each reading, or one of all where they have one degree of freedom."""
        wave, offset = self.wave, self.wave.phasor.offset
        free = (self.read - offset[:, None]) * self.scale[:, None]
        rows = self.rows * self.scale[:, None]
        projector = np.eye(len(rows)) - rows @ np.linalg.pinv(rows)
        left, square = projector @ free, projector.diagonal()
        confusable = projector**2 > (1 - residual.ISOLABLE) * np.outer(square, square)
        names = list(wave.readings)
        if len(names) == UNKNOWNS + 1:
            parity = np.linalg.svd(rows)[0][:, -1]
            total = self._parity(names, parity * self.scale)
            name = f"left{wave.tag or '_of_all'}"
            return [self._watched(name, total, parity @ free, wave.numbers)]
        cos, sin = (self.made.symbols[f"{axis}_seen{wave.tag}"] for axis in ("cos", "sin"))
        out = []
        for k, name in enumerate(names):
            a, b = (
                self._entry(f"fit_{part}_{name}", value, f"read by {name} of the {part} that is seen")
                for part, value in zip(("cos", "sin"), self.rows[k] * self.scale[k], strict=True)
            )
            reading = wave.readings[name]
            if abs(self.scale[k] - 1.0) > EQUAL:
                reading = reading * self._entry(f"fit_{name}", self.scale[k], f"weight of {name}", "1")
            if abs(offset[k]) > LOST:
                about = f"what {name} reads of no field"
                reading = reading - self._entry(f"fit_offset_{name}", offset[k] * self.scale[k], about)
            total = reading - a * cos - b * sin
            others = [wave.numbers[j] for j in np.flatnonzero(confusable[k]) if j != k]
            out.append(self._watched(f"left_{name}", total, left[k], (wave.numbers[k], *others)))
        return out

    def _entry(self, name: str, value: float, about: str, unit: str = "V") -> ca.SX:
        return self.made.entry(name, float(value), unit, about)

    def _parity(self, names: Sequence[str], parity: np.ndarray) -> ca.SX:
        terms = [
            self._entry(f"fit_{name}", value, f"share of {name} in what the readings contradict", "1")
            * self.wave.readings[name]
            for name, value in zip(names, parity, strict=True)
        ]
        shift = float(parity @ self.wave.phasor.offset)
        total = sum(terms[1:], start=terms[0])
        return total - self._entry(f"fit_offset{self.wave.tag or '_of_all'}", shift, "the same of no field")

    def _watched(self, name: str, total: ca.SX, target: np.ndarray, numbers: tuple[int, ...]) -> Watched:
        """Take off what harmonics and tilts read of it."""
        count = self.tilted.shape[0]
        turns = [c for degree in range(TILTS + 1) for c in combined(range(count), degree)]
        orders = (1, *self.wave.phasor.harmonics)
        terms = [(n, c, part) for n in orders for c in turns if n > 1 or c for part in (0, 1)]
        if terms:
            columns = np.array([self._column(*term) for term in terms])
            few = fewest(terms, columns, target, LEAVE * self.unit, rms)
            for k, ((n, c, part), factor) in enumerate(few.items()):
                about = f"{name} per power {n} of the phasor{''.join(f' and rotation {j + 1}' for j in c)}"
                total = total - self._entry(f"{name}_{k + 1}", factor, about) * self._symbol(n, c, part)
        self.made.step(name, total, "[V] that the decoded field leaves")
        return Watched(name, numbers)

    def _column(self, n: int, turns: tuple[int, ...], part: int) -> np.ndarray:
        power = self.u**n
        return np.asarray((power.imag if part else power.real) * np.prod(self.tilted[list(turns)], axis=0))

    def _symbol(self, n: int, turns: tuple[int, ...], part: int) -> ca.SX:
        value = self.powers(n)[part]
        for k in range(len(turns)):  # products of a power and rotations, each made once
            name = f"power_{n}_{'im' if part else 're'}_{''.join(map(str, turns[: k + 1]))}{self.wave.tag}"
            value = self.made.step(name, value * self.tilts[turns[k]])
        return value


def rms(values: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
