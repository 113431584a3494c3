"""Lowering of models of one decaying wave: from three sums or more to the place along it and the height.

A linear map makes cosine and sine of the readings, a few rounds take the higher harmonics off (powers of the same
phasor: no function but + and *), an arctangent gives the place and a logarithm the height, both by polynomials with
proved bounds. What they are made of is found from the model's own readings (`lowering.phasors`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil, log, pi, tanh

import casadi as ca
import numpy as np

from hallsym.codegen.box import Box, limits
from hallsym.codegen.decoupler import Decoupler, Flag, Margin, Step
from hallsym.codegen.entries import Entry, short, unit
from hallsym.codegen.lowering.logarithm import Artanh, artanh
from hallsym.codegen.lowering.phasors import Phasor, phasor
from hallsym.codegen.lowering.trigonometry import ARCTANGENT, arctangent, arctangent_error, odd
from hallsym.codegen.lowering.wave_bounds import Rounding
from hallsym.errors import InputError, counted
from hallsym.model import Model

ENOUGH = 2e-8
"""Place and height [m] that each of the approximations may leave: the rounds of the harmonics, the logarithm."""
ROOM = 0.1
"""Share of the field by which it may leave what the model gives over the box, and a reading of its swing."""
MOST_ROUNDS = 6
LADDER = 20
"""Ends of the polynomial of the logarithm are whole multiples of 1 / LADDER: so code outlasts a calibration."""
NEGLIGIBLE = 0.02
"""Share of `ENOUGH` that harmonics left out may sum to."""
ROUNDED = 1e-13
CONTRACTING = 0.5
"""Largest slope of the higher harmonics over the box for which the rounds are taken to converge."""


def decoupler(model: Model, p: np.ndarray, weight: np.ndarray, box: Box) -> Decoupler:
    """Return the decoupler of a wave at parameters `p` over a box.

    `weight`: 1 / variance of each reading. The place repeats each period; one beyond it is for who knows it.
    Raises `InputError` for readings that are no decaying wave.
    """
    _refuse(model)
    along, height = _coordinates(model)
    found = phasor(model, p, weight, along, height, box.ends[height])
    own = replace(model, period={**model.period, along: 2 * pi * found.lc})
    return _Assembly(own, Wave.of(found, box.ends[height]), box, along, height).make()


def _refuse(model: Model) -> None:
    if model.state:
        raise InputError(
            f"C of a decaying wave is generated from readings that depend on the pose alone; {model.name} with "
            f"{', '.join(model.effects)} needs {', '.join(model.state)}: generate from a calibration without it."
        )
    if any(link == "reference" for link, _ in model.steps):
        raise InputError(
            f"The calibration of {model.name} with {', '.join(model.effects)} holds errors of its reference, "
            "which a controller does not have; fit without that effect, or correct the log's reference."
        )


def _coordinates(model: Model) -> tuple[str, str]:
    """Return the pose coordinate along the wave, which repeats, and the height."""
    along = [c for c in model.pose if c in model.period]
    height = [c for c in model.pose if c not in model.period]
    if len(along) != 1 or len(height) != 1:
        raise InputError(
            f"C of a decaying wave is generated for one coordinate that repeats and one height; {model.name} has "
            f"{', '.join(model.pose)}."
        )
    return along[0], height[0]


@dataclass(frozen=True, eq=False)
class Wave:
    """What a phasor needs to be decoded over a range of heights: rounds, polynomial, and what they leave."""

    phasor: Phasor
    harmonics: tuple[int, ...]
    rounds: int
    least: float
    """|u| below which, and beyond 1 / |u| above which, the flag is set."""
    series: Artanh
    left: float
    """What rounds and harmonics left out leave of ln u."""

    @classmethod
    def of(cls, phasor: Phasor, ends: tuple[float, float]) -> "Wave":
        """Return it for a range of heights. Raises `InputError` where nothing converges."""
        most = max(phasor.size(z) for z in ends)
        harmonics, out = _counting(phasor, most * (1 + ROOM))
        reach = most * (1 + ROOM + phasor.largest(most) / most)
        first, slope = phasor.largest(reach) / reach, 0.0
        outer = reach * (1 + 2 * first)
        slope = phasor.slope(outer)
        if slope > CONTRACTING:
            raise InputError(
                f"The higher harmonics are too strong at the least distance of the box for {phasor.lc * 2e3 * pi:.3g} "
                "mm of wavelength: their correction does not converge; give a smaller range of the height with --range."
            )
        rounds, left = 0, first
        while rounds < MOST_ROUNDS and left * phasor.lc > ENOUGH and harmonics:
            rounds, left = rounds + 1, left * slope
        tangent = tanh(log(reach))
        end = ceil(tangent * LADDER * (1 + 1e-6)) / LADDER
        series = artanh(end, ENOUGH / phasor.lc) if end < 1 else None
        if series is None:
            raise InputError(
                f"The heights of the box span {2e3 * abs(ends[1] - ends[0]):.3g} mm / 2, too many for one logarithm of a "
                f"wavelength of {phasor.lc * 2e3 * pi:.3g} mm; give a smaller range with --range."
            )
        return cls(phasor, harmonics, rounds, 1 / reach, series, left / (1 - left) + out)

    @property
    def tangent(self) -> float:
        """Largest |t| = |s - 1| / (s + 1), s = |u|^2, with the flag clear."""
        return tanh(-log(self.least))

    @property
    def outer(self) -> float:
        """Bound of |u| in every round, with the flag clear."""
        reach = 1 / self.least
        return reach * (1 + 2 * self.phasor.largest(reach) / reach)


def _counting(phasor: Phasor, r: float) -> tuple[tuple[int, ...], float]:
    """Return the harmonics that count within |u| <= r, and what the others leave of ln u at most."""
    each = {n: np.linalg.norm(e, 2) * r ** (n - 1) for n, e in phasor.shares.items()}
    out, total = set(), 0.0
    for n in sorted(each, key=lambda n: each[n]):
        if (total + each[n]) * phasor.lc > NEGLIGIBLE * ENOUGH:
            break
        out.add(n)
        total += each[n]
    return tuple(n for n in phasor.harmonics if n not in out), 2 * total


@dataclass(eq=False)
class Collected:
    """Entries, symbols and steps of one decoupler."""

    table: list[Entry] = field(default_factory=list)
    symbols: dict[str, ca.SX] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)

    def entry(self, name: str, value: float, unit: str, meaning: str) -> ca.SX:
        """Add an entry of the table; returns its symbol."""
        self.table.append(Entry(name, float(value), unit, meaning))
        self.symbols[name] = ca.SX.sym(name)
        return self.symbols[name]

    def step(self, name: str, expression: ca.SX, remark: str = "") -> ca.SX:
        """Add a step; returns its symbol."""
        self.steps.append(Step(name, expression, remark))
        return self.symbols.setdefault(name, ca.SX.sym(name))


def phasor_steps(made: Collected, wave: Wave, readings: Mapping[str, ca.SX], tag: str = "") -> None:
    """Add the steps from readings to cos and sin of the phasor without its higher harmonics."""
    found, about = wave.phasor, {"cos": "cosine", "sin": "sine"}
    for axis, row, shift in zip(("cos", "sin"), found.weights, found.shift, strict=True):
        total = -made.entry(f"{axis}_shift{tag}", shift, "1", f"{about[axis]} that the offsets read")
        for (name, reading), value in zip(readings.items(), row, strict=True):
            factor = made.entry(f"{axis}_{name}{tag}", value, "1/V", f"{about[axis]} of the wave per {name}")
            total = factor * reading + total
        made.step(f"{axis}_seen{tag}" if wave.rounds else f"{axis}{tag}", total, "[1] weighted sums")
    shares = {
        n: [
            made.entry(f"{a}_{b}_{n}{tag}", share[i, j], "1", f"{about[a]} read of {about[b]} of harmonic {n}")
            for i, a in enumerate(about)
            for j, b in enumerate(about)
        ]
        for n, share in found.shares.items()
        if n in wave.harmonics
    }
    for k in range(1, wave.rounds + 1):
        before = f"_{k - 1}{tag}" if k > 1 else f"_seen{tag}"
        after = f"_{k}{tag}" if k < wave.rounds else tag
        powers = Powers(made, made.symbols[f"cos{before}"], made.symbols[f"sin{before}"], f"_{k}{tag}")
        cos, sin = made.symbols[f"cos_seen{tag}"], made.symbols[f"sin_seen{tag}"]
        for n, (cc, cs, sc, ss) in shares.items():
            real, imaginary = powers(n)
            cos, sin = cos - (cc * real + cs * imaginary), sin - (sc * real + ss * imaginary)
        made.step(f"cos{after}", cos, f"[1] without the higher harmonics, {counted(k, 'round')}")
        made.step(f"sin{after}", sin)


class Powers:
    """Powers of a complex number, one step for each part, made where first used."""

    def __init__(self, made: Collected, cos: ca.SX, sin: ca.SX, tag: str) -> None:
        self.made, self.tag, self.known = made, tag, {1: (cos, sin)}

    def __call__(self, n: int) -> tuple[ca.SX, ca.SX]:
        """Return real and imaginary part of the n-th power."""
        if n not in self.known:
            if n % 2:
                (a, b), (c, d) = self(n - 1), self(1)
                parts = a * c - b * d, a * d + b * c
            else:
                a, b = self(n // 2)
                product = a * b
                parts = a * a - b * b, product + product
            names = f"real_{n}{self.tag}", f"imaginary_{n}{self.tag}"
            self.known[n] = self.made.step(names[0], parts[0]), self.made.step(names[1], parts[1])
        return self.known[n]


def logarithm_steps(made: Collected, series: Artanh, tag: str = "") -> ca.SX:
    """Add the steps of ln |u| of cos and sin; returns it."""
    cos, sin = made.symbols[f"cos{tag}"], made.symbols[f"sin{tag}"]
    size = made.step(f"size{tag}", cos * cos + sin * sin, "[1] square of the phasor, 1 at middle height")
    tangent = made.step(f"tangent{tag}", (size - 1.0) / (size + 1.0), "[1] of the logarithm, hyperbolic")
    made.step(f"depth{tag}", -ca.fabs(tangent))
    squared = made.step(f"tangent_square{tag}", tangent * tangent)
    return made.step(f"log{tag}", odd(series.coefficients, tangent, squared), "[1] logarithm, a polynomial")


@dataclass(eq=False)
class _Assembly:
    """Collects the decoupler of one calibration."""

    model: Model
    wave: Wave
    given: Box
    along: str
    height: str

    def make(self) -> Decoupler:
        model, wave, made = self.model, self.wave, Collected()
        found = wave.phasor
        inputs = model.channels
        made.symbols |= {c: ca.SX.sym(short(c)) for c in inputs}
        zeros = tuple(
            Entry(f"zero_{short(c)}", 0.0, unit(c), f"added to {c}; set by decoupler_zero()")
            for c in model.pose
        )
        made.symbols |= {z.name: ca.SX.sym(z.name) for z in zeros}
        phasor_steps(made, wave, {short(c): made.symbols[c] for c in inputs})
        lc = made.entry("lc", found.lc, "m", "wavelength over 2 pi")
        half = made.entry("half_wave", pi * found.lc, "m", "half the wavelength")
        whole = made.entry("wavelength", 2 * pi * found.lc, "m", "wavelength")
        scale = made.entry("per_log", found.rising * found.lc, "m", f"{self.height} per logarithm")
        middle = made.entry("middle", found.middle, "m", f"{self.height} at which the phasor is 1")
        made.entry("lowest", -wave.tangent, "1", "less the largest tangent of the logarithm over the heights")
        logarithm = logarithm_steps(made, wave.series)
        phase = arctangent(made.step, made.symbols["sin"], made.symbols["cos"])
        place = made.step("place", lc * phase + made.symbols[f"zero_{short(self.along)}"])
        last = {
            self.along: ca.if_else(
                place > half, place - whole, ca.if_else(place < -half, place + whole, place)
            ),
            self.height: scale * logarithm + (middle + made.symbols[f"zero_{short(self.height)}"]),
        }
        for column in model.pose:
            made.step(short(column), last[column], f"[{unit(column)}]")
        ends = Box({c: self._ends(k) for k, c in enumerate(inputs)})
        return Decoupler(
            model=model,
            inputs=inputs,
            table=tuple(made.table),
            limits=limits(inputs, ends),
            zeros=zeros,
            steps=tuple(made.steps),
            at_pose=(),
            margins=(Margin(inputs[0], "lc"),),
            box=ends,
            exact=self._exact,
            symbols=made.symbols,
            flags=(
                Flag("FIELD", "depth", "lowest", "field beyond the heights calibrated: too near, too far, none"),
            ),
            approximation=self._left,
            bounded=Rounding(wave, model.pose, self.along, tuple(made.steps), self._values(made, ends)),
            rest=tuple(self._readings(0.0, found.middle).tolist()),
            listed=self._listed(),
            said=self._said(),
        )

    def _exact(self, readings: np.ndarray) -> np.ndarray:
        place, height = self.wave.phasor.pose(self.wave.phasor.solved(np.asarray(readings, dtype=float)))
        return np.array([place if c == self.along else height for c in self.model.pose])

    def _readings(self, place: float, height: float) -> np.ndarray:
        """Readings (n,) at a place and a height."""
        found = self.wave.phasor
        u = found.size(height) * np.exp(1j * place / found.lc)
        powers = u ** np.arange(1, found.factor.shape[1] + 1)
        return np.asarray(found.offset + (found.factor * powers).real.sum(axis=1))

    def _ends(self, k: int) -> tuple[float, float]:
        """Range of a reading: what the model gives over the heights, and some room."""
        found, channel = self.wave.phasor, self.model.channels[k]
        if channel in self.given.ends:
            return self.given.ends[channel]
        most = max(found.size(z) for z in self.given.ends[self.height])
        swing = float((np.abs(found.factor[k]) * most ** np.arange(1, found.factor.shape[1] + 1)).sum())
        swing, offset = swing * (1 + ROOM), float(found.offset[k])
        return float(f"{offset - swing:.3g}"), float(f"{offset + swing:.3g}")

    @cached_property
    def _left(self) -> float:
        """What polynomials and rounds may leave [m]."""
        wave = self.wave
        return wave.phasor.lc * (wave.left + max(arctangent_error(), wave.series.error)) + ROUNDED

    def _values(self, made: Collected, ends: Box) -> Mapping[str, float | tuple[float, float]]:
        values: dict[str, float | tuple[float, float]] = {e.name: e.value for e in made.table}
        return values | {short(c): ends.ends[c] for c in self.model.channels}

    def _listed(self) -> tuple[tuple[float, ...], ...]:
        """No field, the seams of the octants and of the period, and both ends of the heights."""
        found = self.wave.phasor
        out = [found.offset.tolist()]
        for k in range(-4, 5):
            out.append(self._readings(k * pi * found.lc / 4, found.middle).tolist())
        out += [self._readings(0.1 * found.lc, z).tolist() for z in self.given.ends[self.height]]
        return tuple(map(tuple, out))

    def _said(self) -> tuple[str, ...]:
        wave, lc = self.wave, self.wave.phasor.lc
        out = [
            f"{self.along} repeats each {2e3 * pi * lc:.6g} mm; the arctangent is a polynomial of degree "
            f"{2 * len(ARCTANGENT) - 1}: off by at most {arctangent_error() * lc:.2g} m (proved).",
            f"The logarithm is a polynomial of degree {2 * len(wave.series.coefficients) - 1}: off by at most "
            f"{wave.series.error * lc:.2g} m (proved).",
        ]
        if wave.harmonics:
            names = ", ".join(map(str, wave.harmonics))
            out.append(
                f"{counted(wave.rounds, 'round')} take the harmonics {names} off the sums, and leave at most "
                f"{wave.left * lc:.2g} m (proved)."
            )
        return tuple(out)


__all__ = ["Collected", "Powers", "Wave", "decoupler", "logarithm_steps", "phasor_steps"]
_ = Callable
