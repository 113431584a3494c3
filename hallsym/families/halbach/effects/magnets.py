"""Effects of the magnets of a Halbach array: segments that differ, forbidden harmonics, another wavelength.

What is fixed to the mover repeats from run to run and moves with x; what is fixed to the board does not.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from itertools import product
from math import pi

import casadi as ca
import numpy as np

from hallsym.families.halbach.finite import filled, single_magnets
from hallsym.families.halbach.layout import Array, arrays, sensors
from hallsym.families.halbach.links import Seen, middle
from hallsym.families.mechanisms import P, free
from hallsym.model import Facts, Model, Parameter, Signals, Way, effect
from hallsym.model.arguments import Try, found, one_of

HALF_TURN = Way("the mover turned half round about z", "the magnets turn with it, the sensors do not")
LONGER = Way("a longer array", "what its ends make goes away")
HEIGHT = Way("another gap", "harmonic h fades with h times the rate of the first")


LIMIT = 50.0
"""Bounds of what a magnet is off: wide, since the outermost ones are hardly seen, and one that stopped at a
bound would distort its neighbours."""


def segments(model: Model) -> dict[str, range]:
    """Return of each array the numbers of the magnets that sensors see, counted from the array's crest.

    Those within half a wavelength beyond the outermost sensors at the ends of the travel: the field of
    a magnet farther off has faded to what the others can make.
    """
    out = {}
    for name, array in arrays(model.layout).items():
        pitch, i = array.wavelength_m / array.magnets_per_period, array.axis
        own = [s.middle[i] - array.centre[i] for s in sensors(model.layout) if s.array in ("", name)]
        if own:
            near, far = array.under
            low, high = min(own) + near - array.wavelength_m / 2, max(own) + far + array.wavelength_m / 2
            most = array.length_m / 2
            first, last = (int(np.trunc(np.clip(end, -most, most) / pitch)) for end in (low, high))
            out[name] = range(first, last + 1)
    return out


def of_magnets(
    s: Signals,
    model: Model,
    shares: Mapping[tuple[str, int], ca.SX],
    turns: Mapping[tuple[str, int], ca.SX],
) -> ca.SX:
    """Return the field (channels,) that magnets add by their shares of the remanence and their turns [rad].

    Both by array and number. Fields of cuboids, in V by the first harmonic of the whole array, whose
    remanence is its amplitude over sin(pi/n) / (pi/n) (1 - exp(-k t)), n magnets of height t per period.
    Elements in a line across the array see what their middle does.
    """
    none = ca.SX(0)

    def seen_by(e: Seen) -> ca.SX:
        array, of = e.array, sorted({i for name, i in {**shares, **turns} if name == e.array.name})
        if not of:
            return none
        size = s["amplitude"] * np.exp(array.wavenumber * array.level_m) / filled(array, 1) / (2 * pi)
        made = [part.get((array.name, i), none) for part in (shares, turns) for i in of]
        single = _magnets(array, tuple(of))
        if single not in e.known:
            e.known[single] = single(e.u - s["crest"], e.across, e.height, e.up, e.along)
        return size * ca.dot(e.known[single], ca.vertcat(*made))

    rows = []
    for k, sensor in enumerate(sensors(model.layout)):
        elements = s.functions["seen"](s, k)
        groups: dict[float, list[Seen]] = {}
        for element, place in zip(elements, sensor.positions, strict=True):
            groups.setdefault(place[element.array.axis], []).append(element)
        total = sum((len(own) * seen_by(middle(own)) for own in groups.values()), ca.SX(0))
        rows.append(total / len(elements))
    return ca.vertcat(*rows)


@cache
def _magnets(array: Array, which: tuple[int, ...]) -> ca.Function:
    """`(u, across, height, up, along) -> fields` by the share of each magnet, then by its turn; made once."""
    u, across, height, up, along = at = [ca.SX.sym(n) for n in ("u", "across", "height", "up", "along")]
    span = range(which[0], which[-1] + 1)
    borders = [(i - 0.5) * array.wavelength_m / array.magnets_per_period for i in (*span, span.stop)]
    parts = dict(zip(span, single_magnets(array, u, across, height, borders, span), strict=True))
    by = [
        up * away + along * beside
        for of in zip(*(parts[i] for i in which), strict=True)
        for away, beside in of
    ]
    return ca.Function("magnets", at, [ca.vertcat(*by)])


COMMON = (
    "no reading shows what magnets of even, or of odd, number have in common beside their array, nor arrays "
    "beside amplitude and place: the mean of those under the travel stays 0; one with fixed = true in the "
    "machine file sets it instead"
)
"""Said where a fit leaves these means at 0."""


def _of_each(model: Model, effect: str, shares: str = "", turns: str = "") -> Model:
    """Return the model whose magnets differ by parameters of these names, `{}` the magnet's; none if empty.

    Where both are, what all magnets share is the amplitude and the place of the mover: values are those
    beyond the mean of the magnets of even or of odd number under the sensors' travel. Each of several arrays
    has its own mean. A difference between even and odd ones is a field on the far side and a little of a
    third harmonic: it has parameters of its own, since one magnet upside down makes it too.
    """
    known, both = arrays(model.layout), bool(shares and turns)
    of = dict.fromkeys(known, "") if len(known) == 1 else {name: f"{name}_" for name in known}
    seen = segments(model)
    kinds: dict[tuple[str, int], list[int]] = {}
    for name, own in seen.items():
        ends = known[name].magnets_per_period // 2
        kinds |= {(name, odd): [i for i in own[ends:-ends] if i % 2 == odd] for odd in (0, 1)}
    parts = [(n, what, unit) for n, what, unit in ((shares, "remanence", "1"), (turns, "turn", "rad")) if n]
    about = {"remanence": "share of remanence beyond the array's", "turn": "turn of the direction"}

    def peers_of(what: str) -> list[list[str]]:
        """Return the arrays whose mean remanence, or turn, is not seen beside the amplitude, or the place."""
        axes = ((0, 1),) if what == "remanence" else ((0,), (1,))
        return [[n for n, a in known.items() if a.axis in own] for own in axes if len(known) > 1]

    def values(p: P, name: str, what: str) -> dict[tuple[str, int], ca.SX]:
        out = {(array, i): p[name.format(f"{of[array]}{i}")] for array, own in seen.items() for i in own}
        for (array, odd), under in kinds.items() if both else ():
            common = (1 - 2 * odd) * p[f"alternating_{of[array]}{what}"]
            for peers in (own for own in peers_of(what) if array in own):
                each = [p[f"array_{of[a]}{what}"] for a in peers]
                common += each[peers.index(array)] - sum(each, ca.SX(0)) / len(each)
            common -= sum((out[array, i] for i in under), ca.SX(0)) / max(len(under), 1)
            out |= {(array, i): out[array, i] + common for i in seen[array] if i % 2 == odd}
        return out

    def step(s: Signals, p: P) -> None:
        made = {what: values(p, name, what) for name, what, _ in parts}
        s["field"] = s["field"] + of_magnets(s, model, made.get("remanence", {}), made.get("turn", {}))

    new: list[Parameter] = []
    for name, what, unit in parts:
        meanings = {name.format(f"{of[a]}{i}"): f"{about[what]}, of magnet {of[a].replace('_', ' ')}{i}"
                    for a, own in seen.items() for i in own}  # fmt: skip
        for array, label in of.items() if both else ():
            meanings[f"alternating_{label}{what}"] = f"{about[what]}, of even magnets of {array} over all"
            if label:
                meanings[f"array_{label}{what}"] = f"{about[what]}, of all magnets of {array}"
        new += free(meanings, LIMIT, unit)
    wide = model.with_step("field", step, effect=effect, parameters=tuple(new))
    for (name, _, _), ((array, _), under) in product(parts, kinds.items()) if both else ():
        wide = wide.with_gauge([name.format(f"{of[array]}{i}") for i in under], COMMON)
    for _, what, _ in parts if both else ():
        for peers in peers_of(what):
            wide = wide.with_gauge([f"array_{of[a]}{what}" for a in peers], COMMON)
    if len(known) > 1:
        return wide
    ((only, one),) = known.items()
    places = np.linspace(*one.under, len(seen[only]))  # a magnet is seen where it is under the sensors
    return replace(wide, typical=(*model.typical, *((-x, one.level_m) for x in places.tolist())))


CERTAIN = 5.0
"""Standard uncertainties from 0 at which a magnet of the other sign is called upside down."""


def upside_down(values: Mapping[str, float], stds: Mapping[str, float]) -> str:
    """Return which magnets point the other way than most of their array, by array and number, or nothing."""
    known: dict[str, dict[int, tuple[float, float]]] = {}
    for name, share in values.items():
        if found := re.fullmatch(r"(?:remanence_spread|magnet)_(.*_)?(-?\d+)(?:_remanence)?", name):
            label, number = found[1] or "", int(found[2])
            common = values.get(f"array_{label}remanence", 0.0)
            common += (1 - 2 * (number % 2)) * values.get(f"alternating_{label}remanence", 0.0)
            known.setdefault(label, {})[number] = 1 + share + common, stds[name]
    said = []
    for label, own in known.items():
        usual = float(np.median([size for size, _ in own.values()]))
        for number, (size, std) in own.items():
            if size * usual < 0 and abs(size) > CERTAIN * std:
                which = f"{number} of {label[:-1]}" if label else f"{number}"
                said.append(f"Magnet {which} is upside down: {size / usual:.3g} times the usual remanence.")
    return " ".join(said)


@effect(
    link="field", label="each magnet", unless=("magnet_map",), remark=upside_down,
    separate=(HALF_TURN, "a longer stroke"),
)  # fmt: skip
def remanence_spread(model: Model) -> Model:
    """The remanence of the magnets differs from one to the next (mover-fixed)."""
    return _of_each(model, "remanence_spread", shares="remanence_spread_{}")


@effect(link="field", label="each magnet", unless=("magnet_map",), separate=(HALF_TURN, "a longer stroke"))
def magnetisation_angle_error(model: Model) -> Model:
    """The directions of the magnets are off (mover-fixed)."""
    return _of_each(model, "magnetisation_angle_error", turns="magnetisation_angle_error_{}")


@effect(
    link="field", label="remanence and direction of each magnet", remark=upside_down,
    separate=(HALF_TURN, "a longer stroke"),
)  # fmt: skip
def magnet_map(model: Model) -> Model:
    """Each magnet has its own remanence and direction (mover-fixed): a map of the array.

    Field of each magnet as a magnetised rectangle, linear in both. A magnet put in upside down has a share
    of -2 beyond the others of its kind.
    """
    return _of_each(model, "magnet_map", "magnet_{}_remanence", "magnet_{}_turn")


def each_magnet(model: Model, facts: Facts) -> list[Try]:
    """Return the magnets that sensors see, one by one."""
    which = [number for own in segments(model).values() for number in own]
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
        s["field"] = s["field"] - of_magnets(s, model, {key: p[name]}, {})

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
        read, wave = s.functions["harmonic"], (p[f"a{order}"], p[f"b{order}"])
        rows = [read(s, k, order, *wave) for k in range(len(model.channels))]
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
        each = [s.functions["seen"](s, k) for k in range(len(model.channels))]
        beyond = [sum((e.height - e.array.level_m for e in seen), ca.SX(0)) / len(seen) for seen in each]
        s["field"] = s["field"] * ca.exp(-p["fading"] * ca.vertcat(*beyond))

    new = free({"fading": "rate at which the field fades beyond that of the wavelength"}, 50.0, "1/m")
    return model.with_step("field", step, effect="finite_width", parameters=new)
