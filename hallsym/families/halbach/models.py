"""A Halbach array over column sums or single Hall sensors: x along it and the gap z.

Maguire: Multi-Degree of Freedom Position Sensor for Planar Motors, UBC 2015, chapter 2; restored formulas and
what is wrong in the print are in docs/halbach.md. The field of harmonic h at gap z fades with exp(-h k z),
k = 2 pi / wavelength; channel j at x_j reads

    v_j = sum over h = 1, 5: exp(-h k (z - level)) (a_h cos h k (x - x_j) + b_h sin h k (x - x_j)).

Amplitudes in V at the gap `level` (5 mm). An array of stated length and width adds its ends and sides, and
the higher harmonics of cuboid magnets. Valid where the array reaches a period beyond the sensors; effects
add gains, offsets, places, tilts, other harmonics, magnets that differ, and edges.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.families.halbach import finite, links
from hallsym.families.halbach.checks import inspect
from hallsym.families.halbach.layout import (
    USUAL_TRAVEL,
    Array,
    Layout,
    Sensor,
    arrays,
    check_channel,
    check_sums,
    columns,
    part_of,
    sensors,
)
from hallsym.log import Meta
from hallsym.model import Combination, Family, Model, Parameter, Signals

FAMILY = Family("halbach")
"""Of this model; the package puts the whole record here."""
POSE, REFERENCES = ("x_m", "z_m"), ("x_ref_m", "z_ref_m")
WAVELENGTH_M = 0.03
FAR = 100.0
"""Largest amplitude [V]."""
BETWEEN = "ends_between"


@cache
def halbach(layout: Layout | None = None) -> Model:
    """Return the model of one array: amplitudes of the harmonics 1 and 5, common to all channels."""
    layout = columns((-0.01, 0.0, 0.01)) if layout is None else tuple(layout)
    array, seen = array_of(layout), sensors(layout)
    if len(seen) < len(POSE) or phasor_of(layout) is None:
        raise InputError(
            f"A position x and z needs at least two sensors that are not half a wavelength "
            f"({1e3 * array.wavelength_m / 2:g} mm) apart, three at a third of it if offsets are not known; "
            f"instead received {len(seen)}."
        )
    for sensor in seen:
        check_channel(sensor, array)
    parameters = [
        Parameter(f"{part}{h}", 0.6 if (part, h) == ("a", 1) else 0.0, -FAR, FAR, "V", meaning.format(h=h))
        for h in finite.FITTED
        for part, meaning in {
            "a": "amplitude of cos({h} k x) at the level of the array",
            "b": "amplitude of sin({h} k x) at the level of the array",
        }.items()
    ]
    if array.ends and array.rival:
        magnets = f"{array.middle_magnet} in the middle (0) to {array.other.middle_magnet} (1)"
        said = f"ends from those of magnet {magnets}"
        parameters.append(Parameter(BETWEEN, 0.0, -50.0, 50.0, "1", said))
    model = Model(
        name="halbach",
        family=FAMILY,
        pose=POSE,
        references=REFERENCES,
        state=(),
        channels=tuple(sensor.channel for sensor in seen),
        parameters=tuple(parameters),
        steps=(
            ("clock", lambda s, p: links.begin(s, model)),
            ("field", lambda s, p: field(s, p, layout)),
            ("transducer", links.filtered),
            ("electronics", links.read),
        ),
        combinations=(
            Combination(
                "atan2(b1, a1)/k", "m", ("a1", "b1"),
                lambda p: ca.atan2(p["b1"], p["a1"]) / array.wavenumber,
            ),
        ),
        layout=layout,
        closed_form=closed_form,
        period=dict.fromkeys(("x_m", "x_ref_m"), array.wavelength_m),
        absolute=("x_ref_m",),
        begin=lambda v, p: begin(v, p, layout),
        formulas={SUM_OF_SQUARES: lambda v, p: sum_of_squares(v, p, layout)} if _thirds(layout) else {},
        onward=onward,
        typical=tuple((k * array.wavelength_m / 8, array.level_m) for k in range(8)),
        inspect=inspect,
        nearly=array.ends,
    )  # fmt: skip
    return model


def onward(pose: np.ndarray, coordinate: str, values: Mapping[str, float]) -> np.ndarray:
    """Return how the pose (2, samples) changes per nominal metre of x to where the field repeats."""
    out = np.zeros_like(pose)
    out[0] = links.scale_of(coordinate, values)
    return out


def array_of(layout: Layout) -> Array:
    """Return the only array of a layout. Raises `InputError` where there is none or several."""
    known = list(arrays(layout).values())
    if len(known) != 1:
        raise InputError(
            f"A model of x and z has one array; instead received {len(known)}. For several arrays use "
            "halbach_planar."
        )
    return known[0]


# -- links -----------------------------------------------------------------------------------------------


def field(s: Signals, p: Mapping[str, ca.SX], layout: Layout) -> None:
    """Set the field at each channel: its harmonics, with the tilt of each sensor's axis."""
    s["waves"] = {}
    s.functions["seen"] = lambda s, k: seen_by(s, layout, k)
    s.functions["harmonic"] = lambda s, k, h, a, b: harmonic(s, layout, k, h, a, b)
    s["amplitude"] = ca.sqrt(p["a1"] ** 2 + p["b1"] ** 2)
    s["crest"] = -ca.atan2(p["b1"], p["a1"]) / array_of(layout).wavenumber
    waves = {h: (p[f"a{h}"], p[f"b{h}"]) for h in finite.FITTED}
    phase = ca.atan2(p["b1"], p["a1"])
    for h in finite.given(array_of(layout)):
        size = s["amplitude"] * finite.strength(array_of(layout), h)
        waves[h] = size * ca.cos(h * phase), size * ca.sin(h * phase)
    s["field"] = ca.vertcat(
        *(sum(harmonic(s, layout, k, h, a, b) for h, (a, b) in waves.items()) for k in range(len(s["moved"])))
    )
    if array_of(layout).ends:
        s["ends"] = ends(s, p, layout)
        if array_of(layout).rival:
            s["ends"] += p[BETWEEN] * (ends(s, p, (*sensors(layout), array_of(layout).other)) - s["ends"])
        s["field"] = s["field"] + s["ends"] + beside(s, p, layout)


def ends(s: Signals, p: Mapping[str, ca.SX], layout: Layout) -> ca.SX:
    """Return what the ends of the array take at each channel.

    Its magnets are where the phase of the first harmonic says: its middle is `shift` off the nominal one, so
    that a shift of all sensors stays a shift of x. What moves sensors otherwise counts to first order: ends
    are a percent, and smooth.
    """
    array, turn = array_of(layout), s["turn"]
    aim = array.middle_magnet * np.pi / array.magnets_per_period - array.wavenumber * array.middle
    cos, sin = float(np.cos(aim)), float(np.sin(aim))
    phase = ca.atan2(sin * p["a1"] - cos * p["b1"], cos * p["a1"] + sin * p["b1"])
    shift, rows = turn * phase / array.wavenumber, []
    x, z = (ca.SX.sym(n) for n in "xz")
    for k, taken in enumerate(finite.along(layout, turn) or ()):
        slope, seen = s["tilted"][k][0], taken.up((x, z))
        if not slope.is_zero():
            seen = seen * ca.cos(slope) + turn * taken.along((x, z)) * ca.sin(slope)
        by = [s["moved"][k][c] for c in ("x_m", "z_m")]
        dx, _, dz = s["placed"][k]
        if not all(b.is_zero() for b in by):
            seen = seen + ca.jtimes(seen, ca.vertcat(x, z), ca.vertcat(*by))
        rows.append(ca.substitute(seen, ca.vertcat(x, z), ca.vertcat(s["x_m"] + shift - dx, s["z_m"] - dz)))
    return s["amplitude"] * ca.vertcat(*rows)


def beside(s: Signals, p: Mapping[str, ca.SX], layout: Layout) -> ca.SX:
    """Return what the sides of the array add to the first harmonic at each channel."""
    array = array_of(layout)
    across = [finite.across_of(array, sensor, s["turn"]) for sensor in sensors(layout)]
    out = [ca.SX(0)] * len(across)
    for number, own in enumerate(dict.fromkeys(across)):
        share = finite.sides(array, own)
        if not share:
            continue
        gap = s["z_m"] / array.wavelength_m
        wider = sum(c * gap**n for n, c in enumerate(share))
        cos, sin = waves(s, layout, 1, wider, f"side {number} ")
        for k in range(len(across)):
            if across[k] == own:
                out[k] = p["a1"] * cos[k] + s["turn"] * p["b1"] * sin[k]
    return ca.vertcat(*out)


def harmonic(s: Signals, layout: Layout, k: int, h: int, a: ca.SX, b: ca.SX) -> ca.SX:
    """Return what channel k sees of harmonic h: the field along its axis.

    Bz = a cos + b sin of h k (x - x_j); outside the magnets curl B = 0 = div B, so Bx = a sin - b cos.
    """
    if h not in s["waves"]:
        s["waves"][h] = waves(s, layout, h)
    cos, sin = (wave[k] for wave in s["waves"][h])
    b = s["turn"] * b
    slope = s["tilted"][k][0]
    vertical, along = a * cos + b * sin, a * sin - b * cos
    return vertical if slope.is_zero() else ca.cos(slope) * vertical + ca.sin(slope) * along


def waves(
    s: Signals, layout: Layout, h: int, share: ca.SX | None = None, named: str = ""
) -> tuple[ca.SX, ca.SX]:
    """Return exp(-h k (z - level)) cos h k (x - x_j) and the sine of it, (channels,): means of the elements.

    What is moved or placed otherwise turns and scales the waves of the logged x and z: exactly. With
    a `share` that follows z they are times that, and are called `named`.
    """
    array, places = array_of(layout), [[x for x, _ in sensor.positions] for sensor in sensors(layout)]
    q = h * array.wavenumber
    fade = ca.exp(-q * (s["z_m"] - array.level_m)) * (1 if share is None else share)
    cosine, sine = (
        s.derive(f"{named}fade {h} * {f.__name__} {h}kx", fade * f(q * s["x_m"])) for f in (ca.cos, ca.sin)
    )
    along, up = (
        ca.vertcat(*(m[c] for m in s["moved"])) - ca.vertcat(*(at[i] for at in s["placed"]))
        for c, i in (("x_m", 0), ("z_m", 2))
    )
    share = 1 / (1 + s["stretch"]) - 1
    up = up + share * (s["z_m"] + up - array.level_m)
    cos, sin = ca.SX(0), ca.SX(0)
    for e in range(max(map(len, places))):
        shift = along - ca.DM([row[e % len(row)] for row in places])
        there = ca.DM([float(e < len(row)) for row in places])
        c, v = links.rotated((cosine, sine), q * (shift + share * (s["x_m"] + shift)))
        cos, sin = cos + there * c, sin + there * v
    size = ca.exp(-q * up) / ca.DM([len(row) for row in places])
    return cos * size, sin * size


def seen_by(s: Signals, layout: Layout, k: int) -> list[links.Seen]:
    """Return what each element of channel k sees of the array."""
    turn, array, sensor = s["turn"], array_of(layout), sensors(layout)[k]
    moved, (dx, _, dz), slope = s["moved"][k], s["placed"][k], s["tilted"][k][0]
    away, gap = dx - s["x_m"] - moved["x_m"], s["z_m"] + moved["z_m"] - dz
    return [
        links.Seen(array, turn * (x + away), gap, ca.cos(slope), turn * ca.sin(slope), across)
        for (x, _), across in zip(sensor.positions, finite.across_of(array, sensor, turn), strict=True)
    ]


# -- starts ----------------------------------------------------------------------------------------------


def phasor_of(layout: Layout) -> np.ndarray | None:
    """Return the rows (2, channels) that take real and imaginary part of Z from the readings.

    v_j = Re(Z exp(-i k x_j)), Z = (a1 - i b1) exp(i k x - k (z - level)), in least squares: for three
    columns a third apart the sums (2-16), (2-17) of the thesis. None where the places do not tell both.
    """
    q = array_of(layout).wavenumber
    turns = np.array(
        [np.mean(np.exp(1j * q * np.array([x for x, _ in c.positions]))) for c in sensors(layout)]
    )
    rows = np.column_stack([turns.real, turns.imag])
    return np.linalg.pinv(rows) if np.linalg.cond(rows) < SAME_PLACE else None


SAME_PLACE = 100.0
"""Condition of the rows of all places beyond which they are at one place of the period, or half one apart."""


def begin(v: ca.SX, p: Mapping[str, ca.SX], layout: Layout) -> ca.SX:
    """Return x and z from the first harmonic: arctangent (2-19) and logarithm (2-20)."""
    array, rows = array_of(layout), phasor_of(layout)
    re, im = ca.vertsplit(ca.DM(np.asarray(rows)) @ v)
    a, b, lc = p["a1"], p["b1"], 1 / array.wavenumber
    turn = ca.atan2(im * a + re * b, re * a - im * b)  # of Z over (a - i b)
    fade = ca.log((re**2 + im**2) / (a**2 + b**2)) / 2
    return ca.vertcat(lc * turn, array.level_m - lc * fade)


SUM_OF_SQUARES = "sum-of-squares"
"""The thesis's (2-19) and (2-20)."""


def _thirds(layout: Layout) -> bool:
    """Return whether three channels stand a third of the wavelength apart, as (2-20) takes them."""
    rows = phasor_of(layout)
    return rows is not None and rows.shape[1] == 3 and bool(np.allclose(rows @ rows.T, np.eye(2) / 1.5))


def sum_of_squares(v: ca.SX, p: Mapping[str, ca.SX], layout: Layout) -> ca.SX:
    """Return x as `begin` does and z from the sum of all squares, (2-20) with 1.5 for its 1.32.

    What the three readings have in common is taken for a field, which `begin` leaves out.
    """
    array, x = array_of(layout), begin(v, p, layout)[0]
    fade = ca.log(ca.sumsqr(v) / (1.5 * (p["a1"] ** 2 + p["b1"] ** 2))) / 2
    return ca.vertcat(x, array.level_m - fade / array.wavenumber)


def closed_form(model: Model, coefficients: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the amplitudes from the coefficients of the fading waves, the mean over all channels."""
    array, seen = array_of(model.layout), sensors(model.layout)
    found: dict[str, float] = {}
    nothing = np.zeros(len(seen))
    for h in finite.FITTED:
        turns = [np.mean([np.exp(1j * h * array.wavenumber * x) for x, _ in c.positions]) for c in seen]
        cos, sin = (coefficients.get(f"fade {h} * {f} {h}kx", nothing) for f in ("cos", "sin"))
        mean = np.mean((cos - 1j * sin) * np.array(turns)) / np.mean(np.abs(turns) ** 2)
        found |= {f"a{h}": float(mean.real), f"b{h}": float(-mean.imag)}
    return model.vector(found)


# -- machines described by a log -------------------------------------------------------------------------


def from_meta(make: Callable[..., Model], meta: Meta) -> Model:
    """Return the model for the layout that a log or a machine file states.

    `probes` (and `arrays` of a machine file) entry by entry, else what `nominal` says: `lambda_m`,
    `sensor_pitch_m`, `columns` (those of the log otherwise), `column_x_m` a list of places, in the middle of
    the board otherwise, `rows_summed`, `periods`.
    """
    stated = [*(meta.probes or ()), *map(with_ends, meta.raw.get("arrays", ()))]
    nominal = {k: v for k, v in meta.nominal.items() if not isinstance(v, str)}
    changes = {k: {"nominal": float(v)} for k, v in nominal.items() if k in halbach().names}
    wavelength = _number(nominal, "lambda_m", WAVELENGTH_M)
    found = [part_of(entry, wavelength) for entry in stated]
    if any(isinstance(part, Sensor) for part in found):
        own = (*sensors(found), *(arrays(found).values() or [Array("X", wavelength)]))
        return make(_settled(own, meta)).with_parameters(changes)
    names = sorted((c for c in meta.columns if _is_column(c)), key=lambda c: int(c.split("_")[1]))
    if not names and not stated and "columns" not in nominal and "column_x_m" not in nominal:
        return make().with_parameters(changes)
    count = int(_number(nominal, "columns", float(len(names) or 3)))
    pitch = _number(nominal, "sensor_pitch_m", wavelength / 3)
    check_sums(int(_number(nominal, "rows_summed", 1.0)), pitch, wavelength)
    listed = nominal.get("column_x_m")
    places = (
        [(j - (count - 1) / 2) * pitch for j in range(count)] if listed is None else _places(listed, count)
    )
    if names and len(names) != count:
        raise InputError(
            f"The log has {len(names)} columns ({names[0]} to {names[-1]}), but meta.json states {count}; "
            "state 'columns', or a list 'column_x_m', for those of the log."
        )
    about = {"length_m": wavelength * _number(nominal, "periods", 8.0)}
    layout = columns(places, wavelength, names, **about)
    layout = (*sensors(layout), *(arrays(found) or arrays(layout)).values())
    return make(_settled(layout, meta)).with_parameters(changes)


def with_ends(entry: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the entry of an array in a file, with its ends where it states length and width."""
    return {"ends": "length_m" in entry and "width_m" in entry, **entry}


def _settled(layout: Layout, meta: Meta) -> Layout:
    """Return the layout with what its log says of its array: travel, and which magnet is in the middle.

    A file states that magnet by `middle_magnet`. Without a log it points to the sensors. Of an array without
    ends only a travel beyond the usual one counts.
    """
    array = array_of(layout)
    if array.known_m:
        return layout
    log = meta.sample((*REFERENCES, *(s.channel for s in sensors(layout))))
    if not array.ends:
        known = travel(array.wavelength_m, log[:2]) if len(log) else ()
        longer = known and max(-known[0], known[1]) > USUAL_TRAVEL * array.wavelength_m
        return (*sensors(layout), replace(array, known_m=known)) if longer else layout
    if len(log):
        stated = any("middle_magnet" in entry for entry in meta.raw.get("arrays", ()))
        array = replace(array, known_m=travel(array.wavelength_m, log[:2]))
        if finite.beyond(array):
            return (*sensors(layout), array.stated)
        array = _middle((*sensors(layout), array), log, (array.middle_magnet,) if stated else None)
    layout = (*sensors(layout), array)
    return layout if finite.along(layout, 1) else (*sensors(layout), array.stated)


def travel(wave: float, at: np.ndarray) -> tuple[float, ...]:
    """Return least and greatest of coordinates (n, samples) [m], the last the gap, a single sample aside."""
    *plane, (low, high) = np.quantile(at, (STRAY, 1 - STRAY), axis=1).T.tolist()
    gap = max(low - wave / 60, finite.NARROW * wave), high + wave / 60
    return tuple(v for ends in (*plane, gap) for v in ends)


STRAY = 2e-3
"""Share of the samples that may be stray ones."""


def _middle(layout: Layout, log: np.ndarray, among: Sequence[int] | None) -> Array:
    """Return the array with the magnet in its middle, one of `among`, as a log (2 + channels, samples) tells.

    The likelihood of each, where gain, offset, place and harmonics of each channel are its own: the field is
    linear in all but the place of the middle, which the phase of the first harmonic says for each magnet.
    """
    array, (x, z, *readings) = array_of(layout), log
    q, half = array.wavenumber, np.pi / array.magnets_per_period
    shares = {finite.sides(array, finite.across_of(array, s)) for s in sensors(layout)}
    columns = [np.ones(len(x))]
    for h, share in (
        *((h, (1.0,)) for h in (*finite.FITTED, *finite.given(array))),
        *((1, share) for share in shares if share),
    ):
        size = np.polynomial.polynomial.polyval(z / array.wavelength_m, share)
        columns += [size * np.exp(-h * q * (z - array.level_m)) * f(h * q * x) for f in (np.cos, np.sin)]
    design, v = np.array(columns).T, np.array(readings).T
    inverse = np.linalg.pinv(design)
    waves = inverse @ v
    rest = v - design @ waves
    noise = rest.var(axis=0)
    at = np.array([np.mean([np.exp(1j * q * place) for place, _ in s.positions]) for s in sensors(layout)])
    first = complex(np.sum((waves[1] + 1j * waves[2]) * at.conj()) / np.sum(np.abs(at) ** 2))
    found: list[tuple[float, Array, np.ndarray]] = []
    for magnet in range(2 * array.magnets_per_period) if among is None else among:
        turned = np.angle(np.exp(1j * (magnet * half - np.angle(first) - q * array.middle)))
        own = replace(array, middle_magnet=magnet, middle_m=array.middle_m + float(turned) / q)
        known = finite.along((*sensors(layout), own), 1)
        if known is None:
            continue
        taken = abs(first) * np.array([one.up((x, z)) for one in known]).T
        taken -= design @ (inverse @ taken)
        unlikely = (own.middle_m / (ZERO * array.wavelength_m)) ** 2
        found.append((((rest - taken) ** 2 / noise).sum() + unlikely, own, taken))
    if not found:
        return array.stated
    (best, own, taken), *others = sorted(found, key=lambda one: one[0])
    for least, other, seen in others[:1]:
        if least < best + CERTAIN and ((seen - taken) ** 2 / noise).sum() > SEEN:
            return replace(own, rival=round((other.middle_m - own.middle_m) * q / half))
    return own


CERTAIN = 9.0
"""Twice the logarithm of a likelihood ratio below which a rival counts: three standard deviations."""
SEEN = 0.1
"""Least sum of squares, in those of noise, by which readings of a rival differ: else ends are hardly seen."""
ZERO = 1 / 8
"""Wavelengths by which zeros of references are off the middle of an array: half a magnet (an assumption)."""


def _is_column(name: str) -> bool:
    parts = name.split("_")
    return len(parts) == 3 and parts[0] == "col" and parts[1].isdigit() and parts[2] == "v"


def _number(nominal: Mapping[str, Any], key: str, usual: float) -> float:
    value = nominal.get(key, usual)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < np.inf:
        raise InputError(f"Nominal '{key}' must be a positive number; instead it is {value!r}.")
    return float(value)


def _places(listed: Any, count: int) -> Sequence[float]:
    good = isinstance(listed, list) and all(isinstance(x, int | float) for x in listed)
    if not good or len(listed) != count:
        raise InputError(f"Nominal 'column_x_m' must be a list of {count} numbers; instead it is {listed!r}.")
    return [float(x) for x in listed]
