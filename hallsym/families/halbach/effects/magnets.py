"""Effects of the magnets of a Halbach array: segments that differ, forbidden harmonics, another wavelength.

What is fixed to the mover repeats from run to run and moves with x; what is fixed to the board does not.
"""

from math import pi

import casadi as ca
import numpy as np

from hallsym.families.halbach.layout import Array, arrays, sensors
from hallsym.families.mechanisms import P, free
from hallsym.model import Model, Parameter, Signals, Way, effect
from hallsym.model.arguments import one_of

TURNED = Way("the mover turned half round about z", "the magnets turn with it, the sensors do not")
LONGER = Way("a longer array", "what its ends make goes away")
HEIGHT = Way("another gap", "harmonic h fades with h times the rate of the first")


def segments(array: Array) -> np.ndarray:
    """Return the numbers of the magnets beside the one that faces the sensors with its north pole, (n,)."""
    pitch = array.wavelength_m / array.magnets_per_period
    most = int(np.floor(array.length_m / 2 / pitch))
    return np.arange(-most, most + 1)


def magnet_fields(s: Signals, p: P, model: Model) -> list[list[tuple[ca.SX, ca.SX]]]:
    """Return what each channel sees of each magnet: field per share of its remanence, and per rad of turn.

    Complex field of a magnetised rectangle in two dimensions: Bx - i Bz = -i m / (2 pi) (ln corners), m its
    remanence; a turn multiplies m by i. Fields in V by the first harmonic of the whole array, whose remanence
    is its amplitude over (2 sqrt2 / pi)(1 - exp(-k t)) for four magnets of height t per period.
    """
    (array,) = arrays(model.layout).values()
    q, n = array.wavenumber, array.magnets_per_period
    pitch, height = array.wavelength_m / n, array.height
    filled = np.sin(pi / n) / (pi / n) * (1 - np.exp(-q * height))
    size = ca.sqrt(p["a1"] ** 2 + p["b1"] ** 2) * np.exp(q * array.level_m) / filled
    crest = -ca.atan2(p["b1"], p["a1"]) / q  # of Bz, on the mover: a magnet whose north pole faces down
    which = segments(array)
    edges = [crest + (float(i) - 0.5) * pitch for i in (*which, which[-1] + 1)]
    out = []
    for k, sensor in enumerate(sensors(model.layout)):
        moved, (dx, _, dz) = s["moved"][k], s["placed"][k]
        (x, _) = sensor.middle
        u = x + dx - (s["x_m"] + moved["x_m"])
        gap = s["z_m"] + moved["z_m"] - dz
        corner = []
        for edge in edges:
            low, high = ((u - edge) ** 2 + g**2 for g in (gap, gap + height))
            real = ca.log(high / low) / 2
            imag = ca.atan2(u - edge, gap + height) - ca.atan2(u - edge, gap)  # less a constant
            corner.append((real, imag))
        row = []
        for j, i in enumerate(which):
            re, im = (corner[j][c] - corner[j + 1][c] for c in (0, 1))
            turn = pi / 2 - 2 * pi / n * float(i)  # of the magnet's direction from x
            cos, sin = np.cos(turn), np.sin(turn)
            # Bz = Re(m Q) / 2 pi
            row.append(tuple(v * size / (2 * pi) for v in (cos * re - sin * im, -sin * re - cos * im)))
        out.append(row)
    return out


def _of_magnets(model: Model, name: str, part: int, meaning: str, limit: float, unit: str) -> Model:
    (array,) = arrays(model.layout).values()
    names = [f"{name}_{i}" for i in segments(array)]

    def step(s: Signals, p: P) -> None:
        fields = magnet_fields(s, p, model)
        added = [sum(p[n] * pair[part] for n, pair in zip(names, row, strict=True)) for row in fields]
        s["field"] = s["field"] + ca.vertcat(*added)

    new = free({n: f"{meaning} {n.rpartition('_')[2]}" for n in names}, limit, unit)
    return model.with_step("field", step, effect=name, parameters=new)


@effect(link="field", label="each magnet", separate=(TURNED, "a longer stroke"))
def remanence_spread(model: Model) -> Model:
    """The remanence of the magnets differs from one to the next (mover-fixed)."""
    return _of_magnets(model, "remanence_spread", 0, "relative remanence of magnet", 0.5, "1")


@effect(link="field", label="each magnet", separate=(TURNED, "a longer stroke"))
def magnetisation_angle_error(model: Model) -> Model:
    """The directions of the magnets are off (mover-fixed)."""
    return _of_magnets(model, "magnetisation_angle_error", 1, "turn of the direction of magnet", 0.5, "rad")


@effect(link="field", waves=(1, 3), separate=(HEIGHT, LONGER))
def forbidden_harmonics(
    model: Model,
    order: int = one_of(
        {2: "second", 3: "third", 4: "fourth", 9: "ninth"}, "harmonic of the field that is added"
    ),
) -> Model:
    """Harmonics of the field that an ideal array of four magnets per period has not, or the ninth."""
    names = {f"a{order}": "cos", f"b{order}": "sin"}

    def step(s: Signals, p: P) -> None:
        rows = []
        for k in range(len(model.channels)):
            cos, sin = s["wave"](k, order)
            rows.append(p[f"a{order}"] * cos + p[f"b{order}"] * sin)
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
        (array,) = arrays(model.layout).values()
        share = 1 / (1 + p["longer"]) - 1
        for k, (moved, sensor) in enumerate(zip(s["moved"], sensors(model.layout), strict=True)):
            x, _ = sensor.middle
            s["placed"][k][0] = s["placed"][k][0] + share * x
            moved["x_m"] = moved["x_m"] + share * (s["x_m"] + moved["x_m"])
            moved["z_m"] = moved["z_m"] + share * (s["z_m"] + moved["z_m"] - array.level_m)

    new = free({"longer": "share by which the wavelength is longer than nominal"}, 0.1, "1")
    return model.with_step("reference", step, effect="wavelength_error", parameters=new)
