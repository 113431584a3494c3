"""Effects of the magnets of a Halbach array: segments that differ, forbidden harmonics, another wavelength.

What is fixed to the mover repeats from run to run and moves with x; what is fixed to the board does not.
"""

from collections.abc import Mapping
from functools import cache
from math import pi

import casadi as ca
import numpy as np

from hallsym.families.halbach.layout import Array, arrays, sensors
from hallsym.families.halbach.links import Seen
from hallsym.families.mechanisms import P, free
from hallsym.model import Facts, Model, Parameter, Signals, Way, effect
from hallsym.model.arguments import Try, found, one_of

HALF_TURN = Way("the mover turned half round about z", "the magnets turn with it, the sensors do not")
LONGER = Way("a longer array", "what its ends make goes away")
HEIGHT = Way("another gap", "harmonic h fades with h times the rate of the first")


LIMIT = 5.0
"""Bounds of what a magnet is off: wide, since the outermost ones are hardly seen."""


def segments(model: Model) -> list[tuple[str, int]]:
    """Return array and number of the magnets that sensors see, counted from the array's crest.

    Those within a wavelength beyond the outermost sensors, half of it for the stroke: the field of a magnet
    farther off has faded to what the others can make.
    """
    out = []
    for name, array in arrays(model.layout).items():
        pitch, i = array.wavelength_m / array.magnets_per_period, array.axis
        own = [s.middle[i] - array.centre[i] for s in sensors(model.layout) if s.array in ("", name)]
        if own:
            low, high = min(own) - array.wavelength_m, max(own) + array.wavelength_m
            most = array.length_m / 2
            first, last = (int(np.trunc(np.clip(end, -most, most) / pitch)) for end in (low, high))
            out += [(name, number) for number in range(first, last + 1)]
    return out


def of_magnets(s: Signals, model: Model, shares: Mapping[tuple[str, int], ca.SX], part: int) -> ca.SX:
    """Return the field (channels,) that magnets add by their shares of the remanence (part 0) or turns (1).

    `shares`: by array and number, neighbours of an array from first to last.

    Complex field of a magnetised rectangle in two dimensions: Bu - i Bw = -i m / (2 pi) (ln corners), m its
    remanence; a turn multiplies m by i. Fields in V by the first harmonic of the whole array, whose remanence
    is its amplitude over sin(pi/n) / (pi/n) (1 - exp(-k t)), n magnets of height t per period.
    """
    own = {
        name: {number: share for (array, number), share in shares.items() if array == name}
        for name in arrays(model.layout)
    }

    def seen_by(e: Seen) -> ca.SX:
        array, n, of = e.array, e.array.magnets_per_period, own[e.array.name]
        if not of:
            return ca.SX(0)
        filled = np.sin(pi / n) / (pi / n) * (1 - np.exp(-array.wavenumber * array.height))
        size = s["amplitude"] * np.exp(array.wavenumber * array.level_m) / filled / (2 * pi)
        field = _magnets(array, tuple(of), part)
        return field(e.u - s["crest"], e.height, e.up, e.along, size, ca.vertcat(*of.values()))

    rows = [s.functions["seen"](s, k) for k in range(len(model.channels))]
    return ca.vertcat(*(sum(map(seen_by, row), ca.SX(0)) / len(row) for row in rows))


@cache
def _magnets(array: Array, which: tuple[int, ...], part: int) -> ca.Function:
    """`(u, height, up, along, size, shares) -> field`; made once, it is called often."""
    u, height, up, along, size = symbols = [ca.SX.sym(n) for n in ("u", "height", "up", "along", "size")]
    shares, n = ca.SX.sym("shares", len(which)), array.magnets_per_period
    corners = []
    for edge in (*which, which[-1] + 1):
        away = u - (edge - 0.5) * array.wavelength_m / n
        low, high = (away**2 + g**2 for g in (height, height + array.height))
        turn = ca.atan2(away, height + array.height) - ca.atan2(away, height)  # less a constant
        corners.append((ca.log(high / low) / 2, turn))
    fields = []
    for j, i in enumerate(which):
        re, im = (corners[j][c] - corners[j + 1][c] for c in (0, 1))
        angle = pi / 2 - 2 * pi / n * i  # of the magnet's direction from the period's axis
        cos, sin = np.cos(angle), np.sin(angle)
        real, imag = cos * re - sin * im, sin * re + cos * im  # of m Q: Bw and Bu times 2 pi
        fields.append(size * ((-up * imag + along * real) if part else (up * real + along * imag)))
    return ca.Function("magnets", [*symbols, shares], [ca.dot(shares, ca.vertcat(*fields))])


def _of_magnets(model: Model, name: str, part: int, meaning: str, unit: str) -> Model:
    """Each magnet differs from those of an array of the stated amplitude and place; all alike nearly are."""
    which = segments(model)
    several = len(arrays(model.layout)) > 1
    names = [f"{name}_{array}_{i}" if several else f"{name}_{i}" for array, i in which]

    def step(s: Signals, p: P) -> None:
        shares = {key: p[n] for key, n in zip(which, names, strict=True)}
        s["field"] = s["field"] + of_magnets(s, model, shares, part)

    said = {n: f"{meaning} {n.removeprefix(name + '_').replace('_', ' ')}" for n in names}
    return model.with_step("field", step, effect=name, parameters=free(said, LIMIT, unit))


@effect(link="field", label="each magnet", separate=(HALF_TURN, "a longer stroke"))
def remanence_spread(model: Model) -> Model:
    """The remanence of the magnets differs from one to the next (mover-fixed)."""
    return _of_magnets(model, "remanence_spread", 0, "share of remanence beyond the array's, of magnet", "1")


@effect(link="field", label="each magnet", separate=(HALF_TURN, "a longer stroke"))
def magnetisation_angle_error(model: Model) -> Model:
    """The directions of the magnets are off (mover-fixed)."""
    return _of_magnets(model, "magnetisation_angle_error", 1, "turn of the direction of magnet", "rad")


def each_magnet(model: Model, facts: Facts) -> list[Try]:
    """Return the magnets that sensors see, one by one."""
    which = [number for _, number in segments(model)]
    return [Try({"magnet": i}, f"magnet {i}", shapes=1, tried=len(which)) for i in which]


LOST = 0.5
"""Share of its remanence that a magnet must lack to count as lost: missing or broken, no spread."""


@effect(
    link="field",
    separate=(
        Way("a longer stroke", "further magnets are as good as their neighbours, or differ too"),
        HALF_TURN,
    ),
    possible=lambda values: all(v >= LOST for n, v in values.items() if n.startswith("lost_")),
)
def lost_magnet(
    model: Model, magnet: int = found(each_magnet, "number of the magnet from the array's crest")
) -> Model:
    """One magnet is missing, broken or demagnetised (mover-fixed)."""
    key, name = (next(iter(arrays(model.layout))), magnet), f"lost_{magnet}"

    def step(s: Signals, p: P) -> None:
        s["field"] = s["field"] - of_magnets(s, model, {key: p[name]}, 0)

    new = free({name: f"share of its remanence that magnet {magnet} lacks"}, LIMIT, "1")
    return model.with_step("field", step, effect="lost_magnet", parameters=new)


@effect(link="field", waves=(1, 3), separate=(HEIGHT, LONGER))
def forbidden_harmonics(
    model: Model,
    order: int = one_of(
        {2: "second", 3: "third", 4: "fourth", 6: "sixth", 7: "seventh", 9: "ninth"},
        "harmonic of the field that is added",
    ),
) -> Model:
    """Harmonics of the field that an ideal array of four magnets per period has not, or the ninth.

    The fifth is part of the model.
    """
    names = {f"a{order}": "cos", f"b{order}": "sin"}

    def step(s: Signals, p: P) -> None:
        rows = []
        for k in range(len(model.channels)):
            rows.append(s.functions["harmonic"](s, k, order, p[f"a{order}"], p[f"b{order}"]))
        s["field"] = s["field"] + ca.vertcat(*rows)

    new = tuple(
        Parameter(n, 0.0, -10.0, 10.0, "V", f"amplitude of {f}({order} k x) at the level of the array")
        for n, f in names.items()
    )
    return model.with_step("field", step, effect="forbidden_harmonics", parameters=new)


@effect(link="field", label="one wavelength", separate="a stroke over more periods")
def wavelength_error(model: Model) -> Model:
    """The wavelength of the magnets is not nominal: period and decay change together."""

    def step(s: Signals, p: P) -> None:
        s["stretch"] = s["stretch"] + p["longer"]

    new = free({"longer": "share by which the wavelength is longer than nominal"}, 0.1, "1")
    return model.with_step("reference", step, effect="wavelength_error", parameters=new)
