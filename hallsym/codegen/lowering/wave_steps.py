"""Steps from the readings of a decaying wave to the logarithm of its phasor: harmonics, arctangent,
logarithm.

Harmonics: u = seen - g(u), g a sum of powers. A round puts in the last u. After the first, what the second
would do is mostly radial, n |b|^2 |u|^(2 n - 2) of ln |u| for a share b of the conjugate power, as sums at
thirds of the period have it of the fifth: six instructions in place of a round, where they leave at most an
accuracy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, log, pi, tanh

import casadi as ca
import numpy as np

from hallsym.codegen.decoupler import Box, Collected, unit
from hallsym.codegen.lowering.odd_series import PI, Odd, odd, shortest
from hallsym.codegen.lowering.phasors import Phasor
from hallsym.errors import InputError

ROOM = 0.05
"""Share of the field by which it may leave what the model gives over the box before the flag is set."""
MOST_ROUNDS = 6
LADDER = 20
"""Ends of the logarithm's polynomial are whole multiples of 1 / LADDER: so code outlasts a calibration."""
POLYNOMIALS = 0.25
"""Share of an accuracy that arctangent and logarithm may take each; the rounds take what these leave."""
NEGLIGIBLE = 0.02
"""Share of an accuracy that harmonics left out may sum to."""
CONTRACTING = 0.5
"""Largest slope of the higher harmonics over the box for which the rounds are taken to converge."""
NEAR = 1.05
"""More than what the last round leaves adds to |g|: it is far less than a hundredth of u."""
TINY = 1e-30
"""Added to a divisor that may be zero; lost in rounding where it is not."""
QUARTER_PI = PI / 4
PERIODS = 1 << 12
"""Added to whole periods, so that they are no negative number."""
AXES = {"cos": "cosine", "sin": "sine"}
SWING = 0.1
"""Share of its swing by which a reading may leave what the model gives over the box: noise, temperature."""
SAFE = 1.5
"""What errors met over trial poses are multiplied by where they are stated."""
AGAINST = "Against least squares over all readings, converged, in double it"
FIELD = "field beyond the calibrated heights: too near, too far, or no array"
REVERSED = (
    "All readings reversed about their centers (a supply exchanged, a magnet the other way round) are those "
    "of a pose half a period away"
)
"""What is said of a fault that a decoder of what repeats takes for a pose."""
FIFTH = 5
"""The harmonic that square magnets have most of, which has a shorter form where it is alone."""


@dataclass(frozen=True, eq=False)
class Wave:
    """What a phasor needs to be decoded over a range of heights: rounds, polynomials, and what they leave."""

    phasor: Phasor
    harmonics: tuple[int, ...]
    """Those that count, beyond the first."""
    rounds: int
    radial: bool
    """Whether the radial part of a second round follows the only one."""
    least: float
    """|u| below which, and beyond 1 / |u| above which, the flag is set."""
    logarithm: Odd
    arctangent: Odd
    left: float
    """What rounds and harmonics left out leave of ln u."""

    @property
    def error(self) -> float:
        """What everything leaves of place and height, over lc."""
        return self.left + max(self.arctangent.error, self.logarithm.error)

    @property
    def least_inside(self) -> float:
        """1 - t^2 at the least field, t = (s - 1) / (s + 1), s = |u|^2."""
        return 1 - tanh(log(self.least)) ** 2


def _outer(phasor: Phasor, reach: float) -> float:
    """Bound of |u| in every round: the first, u + g(u), is longest; u lies within what the last leaves."""
    return reach + NEAR * phasor.bound(reach)


def wave_of(phasor: Phasor, ends: tuple[float, float], accuracy: float) -> Wave:
    """Return the wave over a range of heights. Raises `InputError` where nothing converges.

    `accuracy`: what rounds and polynomials may leave of place and height [m].
    """
    share = accuracy / phasor.lc
    most = max(phasor.size(z) for z in ends)
    reach = most * (1 + ROOM)
    outer = _outer(phasor, reach)
    if phasor.bound(outer, 1) > CONTRACTING:
        raise InputError(
            "The higher harmonics are too strong at the least gap of the box for a wavelength of "
            f"{2e3 * pi * phasor.lc:.3g} mm: their correction does not converge; give fewer heights with "
            f"--range."
        )
    harmonics, out = _counting(phasor, outer, NEGLIGIBLE * share)
    end = ceil(tanh(log(reach)) * LADDER * (1 + 1e-6)) / LADDER
    logarithm = shortest("artanh", end, POLYNOMIALS * share) if end < 1 else None
    arctangent = shortest("atan", 1.0, POLYNOMIALS * share)
    if logarithm is None or arctangent is None:
        raise InputError(
            f"Heights that span {1e3 * abs(ends[1] - ends[0]):.3g} mm are too many for one logarithm of a "
            f"wavelength of {2e3 * pi * phasor.lc:.3g} mm, or the accuracy of {accuracy:.2g} m is too fine; "
            "give fewer with --range."
        )
    rest = (1 - NEGLIGIBLE) * share - max(logarithm.error, arctangent.error)
    rounds, radial, left = _rounds(phasor, outer, reach, rest)
    if not harmonics:
        rounds, radial, left = 0, False, 0.0
    return Wave(phasor, harmonics, rounds, radial, 1 / reach, logarithm, arctangent, left + out)


def _counting(phasor: Phasor, r: float, share: float) -> tuple[tuple[int, ...], float]:
    """Return the harmonics that count within |u| <= r, and what the others leave of ln u at most."""
    each = {n: float(np.linalg.norm(e, 2)) * r ** (n - 1) for n, e in phasor.shares.items()}
    out, total = set(), 0.0
    for n in sorted(each, key=lambda n: each[n]):
        if 2 * (total + each[n]) > share:
            break
        out.add(n)
        total += each[n]
    return tuple(n for n in phasor.harmonics if n not in out), 2 * total


def _rounds(phasor: Phasor, r: float, reach: float, share: float) -> tuple[int, bool, float]:
    """Return how many rounds, whether a radial part follows, and what they leave of ln u: at most `share`
    where possible.

    e, the distance from the fixed point, falls by the slope of g in each.
    """
    slope, bend, error = phasor.bound(r, 1), phasor.bound(r, 2), NEAR * phasor.bound(reach)
    radial = slope * slope * error + bend / 2 * error**2 + _beside_radial(phasor, r, error)
    ways = [(0, False, error), (1, False, slope * error), (1, True, radial)]
    ways += [(k, False, slope**k * error) for k in range(2, MOST_ROUNDS + 1)]
    left = [e / reach * (1 + 2 * e / reach) for *_, e in ways]
    best = next((k for k, e in enumerate(left) if e <= share), -1)
    return *ways[best][:2], left[best]


def radial_of(phasor: Phasor) -> dict[int, float]:
    """Return n |b|^2 by harmonic: its second order adds that times |u|^(2 n - 2) to ln |u|."""
    return {n: n * abs(conjugate) ** 2 for n, (_, conjugate) in phasor.parts.items()}


def _beside_radial(phasor: Phasor, r: float, before: float) -> float:
    """Bound of what the second order of g does beside its radial part, and of what that loses by being added
    to ln |u|, not to u, times r."""
    sizes, radial = {n: abs(a) + abs(b) for n, (a, b) in phasor.parts.items()}, radial_of(phasor)
    beside = 0.0
    if sum(radial.values()):
        every = sum(n * a * b * r ** (n + m - 1) for n, a in sizes.items() for m, b in sizes.items())
        beside = every - sum(f * r ** (2 * n - 1) for n, f in radial.items())
    term = sum(f * r ** (2 * n - 2) for n, f in radial.items())
    return float(beside + term * (NEAR * before + r * term))


def measured(met: str, leaves: Mapping[str, float], trials: int, of: str = "") -> tuple[str, str]:
    """Return the sentences on what a decoder `leaves` of each coordinate, met over trial poses."""
    listed = ", ".join(f"{c} {v:.2g} {unit(c)}" for c, v in leaves.items())
    return (
        f"{met} leaves at most {listed}{of}: {SAFE:g} times what {trials} poses of the box met "
        "(measured, not proved for every pose).",
        "Only readings of a pose in the box have that error: others give a finite pose, mostly a flag.",
    )


def ranges(channels: Sequence[str], seen: np.ndarray, given: Box) -> dict[str, tuple[float, float]]:
    """Return the range of each reading: as `given`, or both ends alike, what is seen (n, s) and room."""
    middle, swing = (seen.max(axis=1) + seen.min(axis=1)) / 2, np.ptp(seen, axis=1) / 2
    ends = [float(f"{end:.3g}") for end in np.abs(middle) + swing * (1 + SWING)]
    return {c: given.ends.get(c, (-end, end)) for c, end in zip(channels, ends, strict=True)}


Pair = tuple[ca.SX, ca.SX]
"""Real and imaginary part."""


def phasor_steps(made: Collected, wave: Wave, readings: Mapping[str, ca.SX], tag: str = "") -> Pair:
    """Add the steps from readings to cosine and sine of the phasor without its higher harmonics."""
    found = wave.phasor
    seen: list[ca.SX] = []
    for axis, row, shift in zip(AXES, found.weights, found.shift, strict=True):
        entries = [
            made.entry(f"{axis}_{name}{tag}", value, "1/V", f"{AXES[axis]} of the wave per {name}")
            for name, value in zip(readings, row, strict=True)
        ]
        total = entries[0] * next(iter(readings.values()))
        total -= made.entry(f"{axis}_shift{tag}", shift, "1", f"{AXES[axis]} that the offsets read")
        for entry, reading in zip(entries[1:], list(readings.values())[1:], strict=True):
            total = total + entry * reading
        seen.append(made.step(f"{axis}_seen{tag}", total, "" if seen else "[1] weighted sums"))
    shares = {
        n: [
            made.entry(f"{a}_{b}_{n}{tag}", found.shares[n][i, j], "1", f"{AXES[a]} read of {AXES[b]} {n}")
            for i, a in enumerate(AXES)
            for j, b in enumerate(AXES)
        ]
        for n in wave.harmonics
    }
    at: Pair = (seen[0], seen[1])
    for k in range(1, wave.rounds + 1):
        powers = Powers(made, *at, f"_{k}{tag}", wave.harmonics)
        sums = _shared(shares, [powers(n) for n in wave.harmonics])
        about = f"[1] higher harmonics off, round {k}"
        at = (
            made.step(f"cos_{k}{tag}", seen[0] - sums[0], about),
            made.step(f"sin_{k}{tag}", seen[1] - sums[1]),
        )
    return at


def _shared(shares: Mapping[int, list[ca.SX]], powers: Sequence[Pair]) -> Pair:
    """Return what cosine and sine hold of some powers."""
    cos, sin = [], []
    for (cc, cs, sc, ss), (real, imaginary) in zip(shares.values(), powers, strict=True):
        cos.append(cc * real + cs * imaginary)
        sin.append(sc * real + ss * imaginary)
    return sum(cos[1:], start=cos[0]), sum(sin[1:], start=sin[0])


def _times(made: Collected, a: Pair, b: Pair, name: str) -> Pair:
    real = made.step(f"real{name}", a[0] * b[0] - a[1] * b[1])
    return real, made.step(f"imaginary{name}", a[0] * b[1] + a[1] * b[0])


class Powers:
    """Powers of a complex number, one step for each part, made where first used.

    `wanted`: those that will be asked for, where it is known.
    """

    def __init__(self, made: Collected, cos: ca.SX, sin: ca.SX, tag: str, wanted: Sequence[int] = ()) -> None:
        self.made, self.tag, self.known = made, tag, {1: (cos, sin)}
        others = [n for n in wanted if n != FIFTH]
        self.fifth_alone = FIFTH in wanted and not any({2, FIFTH - 1} & _chain(n) for n in others)

    def __call__(self, n: int) -> Pair:
        """Return real and imaginary part of the n-th power."""
        made, tag = self.made, self.tag
        if n in self.known:
            return self.known[n]
        if n == FIFTH and self.fifth_alone:
            return self._fifth()
        if n % 2:
            return _times(made, self(n - 1), self(1), f"_{n}{tag}")
        a, b = self(n // 2)
        real = made.step(f"real_{n}{tag}", a * a - b * b)
        half = made.step(f"half_{n}{tag}", a * b)
        return real, made.step(f"imaginary_{n}{tag}", half + half)

    def _fifth(self) -> Pair:
        """cos 5 x = cos x (4 y^2 - 2 y - 1), sin 5 x = sin x (4 y^2 + 2 y - 1), y = cos 2 x: no fourth power.

        Five products fewer than by squares where the length is needed too.
        """
        made, tag, (a, b) = self.made, self.tag, self(1)
        size = made.step(f"length_2{tag}", a * a + b * b, "[1] squares of the length")
        square = made.step(f"length_4{tag}", size * size)
        squared = made.step(f"real_2{tag}", a * a - b * b)
        twice = made.step(f"twice_real_2{tag}", squared + squared)
        even = made.step(f"even_5{tag}", twice * twice - square)
        side = made.step(f"side_5{tag}", twice * size)
        real = made.step(f"real_5{tag}", a * (even - side))
        return real, made.step(f"imaginary_5{tag}", b * (even + side))


def _chain(n: int) -> set[int]:
    """Return the powers that are made on the way to the n-th by squares."""
    return {n} if n == 1 else {n} | _chain(n - 1 if n % 2 else n // 2)


def logarithm_steps(made: Collected, wave: Wave, u: Pair, tag: str = "") -> ca.SX:
    """Add the steps of ln |u|; returns it. The step "inside" is what the flag looks at."""
    size = made.step(f"size{tag}", u[0] * u[0] + u[1] * u[1], "[1] square of the phasor, 1 at middle height")
    t = made.step(f"tangent{tag}", (size - 1.0) / (size + 1.0), "[1] of its logarithm, hyperbolic", most=1.0)
    square = made.step(f"tangent_square{tag}", t * t)
    made.step(f"inside{tag}", 1.0 - square)
    total = odd(wave.logarithm.coefficients, t, square)
    if wave.radial:
        # the square of the phasor as it was seen, and its powers that the first round has made
        names = ((n, f"length_{2 * n}_1{tag}") for n in (1, 2))
        known = {n: made.symbols[name] for n, name in names if name in made.symbols}
        if not known:
            cos, sin = (made.symbols[f"{axis}_seen{tag}"] for axis in AXES)
            known = {1: made.step(f"size_seen{tag}", cos * cos + sin * sin)}
        for n in wave.harmonics:
            value = radial_of(wave.phasor)[n]
            entry = made.entry(
                f"radial_{n}{tag}", value, "1", f"second order of harmonic {n} in the logarithm"
            )
            total = total + entry * power(made, known, n - 1, f"size_seen{tag}")
    return made.step(f"log{tag}", total, "[1] logarithm, a polynomial")


def power(made: Collected, known: dict[int, ca.SX], n: int, name: str) -> ca.SX:
    """Return the n-th power of a number, one step for each product."""
    if n not in known:
        a, b = power(made, known, n // 2, name), power(made, known, n - n // 2, name)
        known[n] = made.step(f"{name}_{n}", a * b)
    return known[n]


def periods_steps(made: Collected, away: ca.SX, tag: str, remark: str = "") -> ca.SX:
    """Add the steps that round a number of periods; returns the whole number."""
    count = made.step(f"periods{tag}", away + (PERIODS + 0.5))
    most = 2.0 * PERIODS  # of readings of no pose it could be anything
    below = made.step(f"counted_to{tag}", ca.if_else(count < most, count, most), remark)
    clamped = made.step(f"counted{tag}", ca.if_else(below > 0.0, below, 0.0))
    return made.whole(f"whole{tag}", clamped) - float(PERIODS)


def least_inside(made: Collected, waves: Sequence[Wave]) -> None:
    """Add the entry that the flag of the field compares with."""
    value, about = min(w.least_inside for w in waves), "1 - t^2 at the ends of the heights, t as computed"
    made.entry("least_inside", float(value), "1", about, "sign")


def arctangent_steps(made: Collected, wave: Wave, u: Pair, tag: str = "") -> ca.SX:
    """Add the steps of the angle of u by quadrants; returns it [rad].

    Correct rounding keeps |b - a| <= b + a of two magnitudes, so no tangent is beyond 1.
    """
    across, up = (made.step(f"{n}{tag}", ca.fabs(v)) for n, v in zip(("across", "up"), u, strict=True))
    t = made.step(
        f"turned{tag}", (up - across) / ((up + across) + TINY), "[1] tangent of the angle - pi / 4", most=1.0
    )
    square = made.step(f"turned_square{tag}", t * t)
    series = odd(wave.arctangent.coefficients, t, square)
    quadrant = made.step(f"quadrant{tag}", QUARTER_PI + series, "[rad] in the first quadrant")
    beyond = made.step(f"beyond{tag}", PI - quadrant)
    half = made.step(f"half{tag}", ca.if_else(u[0] < 0, beyond, quadrant))
    return made.step(f"phase{tag}", ca.if_else(u[1] < 0, -half, half), "[rad] angle of the phasor")
