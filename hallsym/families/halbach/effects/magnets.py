"""Effects of the magnets of a Halbach array: segments that differ, forbidden harmonics, another wavelength.

What is fixed to the mover repeats from run to run and moves with x; what is fixed to the board does not.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import product
from math import pi
from types import MappingProxyType

import casadi as ca
import numpy as np

from hallsym.families.halbach.finite import filled, single_magnets
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

    Those within half a wavelength beyond the outermost sensors at the ends of the travel: the field of
    a magnet farther off has faded to what the others can make.
    """
    out = []
    for name, array in arrays(model.layout).items():
        pitch, i = array.wavelength_m / array.magnets_per_period, array.axis
        own = [s.middle[i] - array.centre[i] for s in sensors(model.layout) if s.array in ("", name)]
        if own:
            near, far = array.under
            low, high = min(own) + near - array.wavelength_m / 2, max(own) + far + array.wavelength_m / 2
            most = array.length_m / 2
            first, last = (int(np.trunc(np.clip(end, -most, most) / pitch)) for end in (low, high))
            out += [(name, number) for number in range(first, last + 1)]
    return out


def of_magnets(
    s: Signals,
    model: Model,
    shares: Mapping[tuple[str, int], ca.SX],
    turns: Mapping[tuple[str, int], ca.SX] = MappingProxyType({}),
) -> ca.SX:
    """Return the field (channels,) that magnets add by their shares of the remanence and their turns [rad].

    Both by array and number. Complex field of a magnetised rectangle in two dimensions:
    Bu - i Bw = -i m / (2 pi) (ln corners), m its remanence; a turn multiplies m by i. Fields in V by the
    first harmonic of the whole array, whose remanence is its amplitude over sin(pi/n) / (pi/n)
    (1 - exp(-k t)), n magnets of height t per period.
    """
    which = {name: [i for array, i in {**shares, **turns} if array == name] for name in arrays(model.layout)}
    none = ca.SX(0)

    def seen_by(e: Seen) -> ca.SX:
        array, of = e.array, sorted(set(which[e.array.name]))
        if not of:
            return none
        size = s["amplitude"] * np.exp(array.wavenumber * array.level_m) / filled(array, 1) / (2 * pi)
        made = (ca.vertcat(*(part.get((array.name, i), none) for i in of)) for part in (shares, turns))
        return _magnets(array, tuple(of))(e.u - s["crest"], e.height, e.up, e.along, size, *made)

    rows = [s.functions["seen"](s, k) for k in range(len(model.channels))]
    return ca.vertcat(*(sum(map(seen_by, row), ca.SX(0)) / len(row) for row in rows))


@cache
def _magnets(array: Array, which: tuple[int, ...]) -> ca.Function:
    """`(u, height, up, along, size, shares, turns) -> field`; made once, it is called often."""
    u, height, up, along, size = symbols = [ca.SX.sym(n) for n in ("u", "height", "up", "along", "size")]
    n, shares, turns = array.magnets_per_period, *(ca.SX.sym(f, len(which)) for f in ("shares", "turns"))
    span = range(which[0], which[-1] + 1)
    borders = [(i - 0.5) * array.wavelength_m / n for i in (*span, span.stop)]
    parts = dict(zip(span, single_magnets(array, u, height, borders, span), strict=True))
    field = ca.SX(0)
    for j, i in enumerate(which):
        real, imag = parts[i]  # of m Q: Bw and Bu times 2 pi
        field += shares[j] * (up * real + along * imag) + turns[j] * (along * real - up * imag)
    return ca.Function("magnets", [*symbols, shares, turns], [size * field])


ALTERNATING = (
    Parameter(
        "alternating_remanence", 0.0, -LIMIT, LIMIT, "1", "what even magnets have beyond the mean of all"
    ),
    Parameter("alternating_turn", 0.0, -LIMIT, LIMIT, "rad", "turn of even magnets beyond the mean of all"),
)
"""Of the magnets under the travel, shares and turns; those of odd number have as much less."""
COMMON = (
    "no reading shows what magnets of even, or of odd, number have in common beside the array: the mean of "
    "those under the travel stays 0; one with fixed = true in the machine file sets it instead"
)
"""Said where a fit leaves these means at 0."""
SHARE, TURN = "share of remanence beyond the array's, of magnet", "turn of the direction of magnet"


def _of_each(model: Model, effect: str, shares: str = "", turns: str = "") -> Model:
    """Return the model whose magnets differ by parameters of these names, `{}` the magnet's; none if empty.

    Where both are, what all magnets of a single array share is its amplitude and its place: values are those
    beyond the mean of the magnets of even or of odd number under the sensors' travel, which is the array's. A
    difference between even and odd ones is a field on the far side and a little of a third harmonic: it has
    parameters of its own (`ALTERNATING`), since one magnet upside down makes it too.
    """
    which = segments(model)
    several = len(arrays(model.layout)) > 1
    labels = {(array, i): f"{array}_{i}" if several else f"{i}" for array, i in which}
    ends = next(iter(arrays(model.layout).values())).magnets_per_period // 2
    both = bool(shares and turns) and not several
    under = [[k for k in which[ends:-ends] if k[1] % 2 == odd] for odd in (0, 1)] if both else []

    def step(s: Signals, p: P) -> None:
        parts = [
            {key: p[name.format(n)] for key, n in labels.items()} if name else {} for name in (shares, turns)
        ]
        for part, q in zip(parts, ALTERNATING if both else (), strict=False):
            means = [sum((part[k] for k in own), ca.SX(0)) / max(len(own), 1) for own in under]
            part |= {k: v - means[k[1] % 2] + (-1) ** k[1] * p[q.name] for k, v in part.items()}
        s["field"] = s["field"] + of_magnets(s, model, *parts)

    new = [
        parameter
        for name, meaning, unit in ((shares, SHARE, "1"), (turns, TURN, "rad"))
        if name
        for parameter in free(
            {name.format(n): f"{meaning} {n.replace('_', ' ')}" for n in labels.values()}, LIMIT, unit
        )
    ]
    wide = model.with_step("field", step, effect=effect, parameters=(*new, *(ALTERNATING if both else ())))
    for name, own in product((shares, turns), under):
        wide = wide.with_gauge([name.format(labels[k]) for k in own], COMMON)
    if len(model.pose) > 2:
        return wide
    (array,) = arrays(model.layout).values()
    places = np.linspace(*array.under, len(which))  # a magnet is seen where it is under the sensors
    return replace(wide, typical=(*model.typical, *((-x, array.level_m) for x in places.tolist())))


@effect(link="field", label="each magnet", unless=("magnet_map",), separate=(HALF_TURN, "a longer stroke"))
def remanence_spread(model: Model) -> Model:
    """The remanence of the magnets differs from one to the next (mover-fixed)."""
    return _of_each(model, "remanence_spread", shares="remanence_spread_{}")


@effect(link="field", label="each magnet", unless=("magnet_map",), separate=(HALF_TURN, "a longer stroke"))
def magnetisation_angle_error(model: Model) -> Model:
    """The directions of the magnets are off (mover-fixed)."""
    return _of_each(model, "magnetisation_angle_error", turns="magnetisation_angle_error_{}")


@effect(link="field", label="remanence and direction of each magnet", separate=(HALF_TURN, "a longer stroke"))
def magnet_map(model: Model) -> Model:
    """Each magnet has its own remanence and direction (mover-fixed): a map of the array.

    Field of each magnet as a magnetised rectangle, linear in both. A magnet put in upside down has a share
    of -2 beyond the others of its kind.
    """
    return _of_each(model, "magnet_map", "magnet_{}_remanence", "magnet_{}_turn")


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
        s["field"] = s["field"] - of_magnets(s, model, {key: p[name]})

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


@effect(
    link="field",
    label="one rate of fading",
    separate=Way("a known step of the gap beside the reference", "a scale of z is not in it"),
)
def finite_width(model: Model) -> Model:
    """The array is narrow: its field fades faster with the gap than the wavelength says.

    A field of harmonic h that also changes across the array with q [rad/m] fades at the rate
    sqrt((h k)^2 + q^2), about h k + q^2 / (2 h k) (Laplace). The second term is taken for all harmonics
    alike: at the level of the array the first one makes 99 % of the field.
    """

    def step(s: Signals, p: P) -> None:
        beyond = []
        for k in range(len(model.channels)):
            seen = s.functions["seen"](s, k)
            beyond.append(sum((e.height - e.array.level_m for e in seen), ca.SX(0)) / len(seen))
        s["field"] = s["field"] * ca.exp(-p["fading"] * ca.vertcat(*beyond))

    new = free({"fading": "rate at which the field fades beyond that of the wavelength"}, 50.0, "1/m")
    return model.with_step("field", step, effect="finite_width", parameters=new)
