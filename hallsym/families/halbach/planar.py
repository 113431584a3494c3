"""Four Halbach arrays on a mover, two along x and two along y, over a board of Hall sensors: six coordinates.

Maguire, UBC 2015, section 2.5, with the exact pose of a rigid body in place of small angles. The mover's
pose is its position t = (x, y, z), z the gap, and its rotation R = Rz Ry Rx (mover to board axes). A sensor
at board position s is at m = R^T (s - t) in mover axes; an array with its centre at c sees it at u = m - c
along its period. With k = 2 pi / wavelength its field there is, in mover axes,

    Bw = sum over h = 1, 5: a_h exp(h k (m_z + level)) cos h k u,   Bu = minus the same with the sine,

and the sensor reads the component along its own axis: (Bu, Bw) turned into the board's axes. Arrays of stated
length and width add their ends and the higher harmonics of cuboid magnets.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from hallsym.errors import InputError
from hallsym.families.halbach import finite, links
from hallsym.families.halbach.checks import in_mover, inspect
from hallsym.families.halbach.layout import (
    Array,
    Layout,
    Sensor,
    arrays,
    check_channel,
    opposite,
    part_of,
    sensors,
)
from hallsym.families.halbach.models import FAR, WAVELENGTH_M, travel, with_ends
from hallsym.log import Meta
from hallsym.model import Family, Model, Parameter, Signals

FAMILY = Family("halbach_planar")
"""Of this model; the package puts the whole record here."""
POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
REFERENCES = tuple(f"{c.rpartition('_')[0]}_ref_{c.rpartition('_')[2]}" for c in POSE)
TYPICAL = 6
"""Poses over which noise is averaged."""


@cache
def halbach_planar(layout: Layout | None = None) -> Model:
    """Return the model of four arrays: two amplitudes, and the place of the reference on the board."""
    layout = pinwheel() if layout is None else tuple(layout)
    seen = sensors(layout)
    check(layout)
    first = next(iter(arrays(layout).values()))
    parameters = (
        Parameter("a1", 0.6, -FAR, FAR, "V", "amplitude of the first harmonic at the level of the arrays"),
        Parameter("a5", 0.0, -FAR, FAR, "V", "amplitude of the fifth harmonic at the level of the arrays"),
        *(
            Parameter(f"{a}0", 0.0, -0.02, 0.02, "m", f"{a} of the mover at the zero of the reference")
            for a in "xy"
        ),
        *(
            Parameter(f"r{a}0", 0.0, -0.05, 0.05, "rad", f"r{a} of the mover at the zero of the reference")
            for a in "xyz"
        ),
    )
    model = Model(
        name="halbach_planar",
        family=FAMILY,
        pose=POSE,
        references=REFERENCES,
        state=(),
        channels=tuple(sensor.channel for sensor in seen),
        parameters=parameters,
        steps=(
            ("clock", lambda s, p: links.begin(s, model)),
            ("field", lambda s, p: field(s, p, layout)),
            ("transducer", links.filtered),
            ("electronics", links.read),
        ),
        layout=layout,
        period=dict.fromkeys(("x_m", "y_m", "x_ref_m", "y_ref_m"), first.wavelength_m),
        absolute=("x_ref_m", "y_ref_m"),
        begin=lambda v, p: begin(v, p, layout),
        onward=onward,
        guess=guess,
        inspect=inspect,
        typical=tuple(map(tuple, _typical(first.level_m, first.wavelength_m))),
    )
    return model


def _typical(level: float, wave: float) -> np.ndarray:
    """Poses in the box of the thesis: a third of a period, 1 mm of gap, 5 mrad; the same every time."""
    rng = np.random.default_rng(1)
    size = np.array([wave / 3, wave / 3, 1e-3, 5e-3, 5e-3, 5e-3])
    return np.array([0, 0, level + 1e-3, 0, 0, 0]) + size * rng.uniform(-1, 1, (TYPICAL, 6))


# -- the pose of a rigid body ------------------------------------------------------------------------------

Rigid = Callable[[tuple[ca.SX, ...]], tuple[ca.SX, ca.SX]]
"""What is added to the logged pose -> rotation (3, 3) and place (3,) of the mover on the board."""


def seen_by(s: Signals, rigid: Rigid, layout: Layout, k: int) -> list[links.Seen]:
    """Return what each element of channel k sees of its array."""
    sensor, known = sensors(layout)[k], arrays(layout)
    moved, placed, tilted = s["moved"][k], s["placed"][k], s["tilted"][k]
    turn, at = rigid(tuple(moved.values()))
    array = known[sensor.array] if s["turn"] > 0 else opposite(layout, known[sensor.array])
    i, out = array.axis, []
    for x, y in sensor.positions:
        m, axis = _in_mover()(turn, at, ca.vertcat(x, y, 0) + ca.vertcat(*placed), ca.vertcat(*tilted))
        if s["turn"] < 0:
            m, axis = HALF_TURN * m, HALF_TURN * axis
        m = m - ca.vertcat(*array.centre, 0)
        shift, own = s["mounted"][array.name]
        m, axis = own.T @ (m - shift), own.T @ axis
        out.append(links.Seen(array, m[i], -m[2], axis[2], axis[i], m[1 - i], axis[1 - i]))
    return out


HALF_TURN = ca.DM([-1, -1, 1])
"""What half a turn about z makes of a vector's components."""


@cache
def _in_mover() -> ca.Function:
    """`(R, t, place, slopes) -> place and axis` of a sensor in mover axes; made once, it is called often."""
    turn, at, place = ca.SX.sym("turn", 3, 3), ca.SX.sym("at", 3), ca.SX.sym("place", 3)
    slopes = ca.SX.sym("slopes", 2)
    axis = ca.vertcat(slopes, 1) / ca.sqrt(1 + ca.sumsqr(slopes))
    return ca.Function("in_mover", [turn, at, place, slopes], [turn.T @ (place - at), turn.T @ axis])


def rigid(s: Signals, p: Mapping[str, ca.SX]) -> Rigid:
    """Return a function of what is added to the logged pose: rotation and place of the mover on the board."""
    known: dict[tuple[int, ...], tuple[ca.SX, ca.SX]] = {}

    def pose(moved: tuple[ca.SX, ...]) -> tuple[ca.SX, ca.SX]:
        key = tuple(0 if m.is_zero() else m.__hash__() for m in moved)
        if key not in known:
            x, y, z, rx, ry, rz = (s[c] + m for c, m in zip(POSE, moved, strict=True))
            at = ca.vertcat(x + p["x0"], y + p["y0"], z)
            known[key] = links.rotation(rx + p["rx0"], ry + p["ry0"], rz + p["rz0"]), at
        return known[key]

    return pose


def field(s: Signals, p: Mapping[str, ca.SX], layout: Layout) -> None:
    """Set the field at each channel: the harmonics of its array along its sensors' axes."""
    pose = rigid(s, p)
    seen = cache(lambda k: seen_by(s, pose, layout, k))
    s.functions["seen"], s.functions["harmonic"] = lambda s, k: seen(k), harmonic
    s["crest"], s["amplitude"] = ca.SX(0), p["a1"]
    rows = []
    for k in range(len(s["moved"])):
        array = seen(k)[0].array
        sizes = {h: p[f"a{h}"] for h in finite.FITTED}
        sizes |= {h: p["a1"] * finite.strength(array, h) for h in finite.given(array)}
        rows.append(sum(harmonic(s, k, h, a, ca.SX(0)) for h, a in sizes.items()))
    s["field"] = ca.vertcat(*rows)
    if ended(layout):
        s["ends"] = p["a1"] * ca.vertcat(*(taken_at(s, layout, k) for k in range(len(rows))))
        s["field"] = s["field"] + s["ends"]


def ended(layout: Layout) -> bool:
    """Return whether the model has the ends of the arrays."""
    return all(array.ends for array in arrays(layout).values())


def taken_at(s: Signals, layout: Layout, k: int) -> ca.SX:
    """Return what ends of the arrays take at a channel, at the mean place and axis of its elements."""
    seen, sensor, turn = s.functions["seen"](s, k), sensors(layout)[k], s["turn"]
    taken = (finite.under(layout, turn) or ())[k]
    there = [e for e, place in zip(seen, sensor.positions, strict=True) if np.allclose(place, sensor.middle)]
    e = links.middle(there or seen)
    return taken.seen(ca.vertcat(e.u, e.across, e.height), e.along, e.aside)


def harmonic(s: Signals, k: int, h: int, a: ca.SX, b: ca.SX) -> ca.SX:
    """Return what channel k sees of harmonic h, a cos + b sin across the array, -(a sin - b cos) along it."""
    seen = s.functions["seen"](s, k)
    parts = [
        _harmonic()(
            h * e.array.wavenumber / (1 + s["stretch"]), e.array.level_m, e.u, e.height, e.up, e.along, a, b
        )
        for e in seen
    ]
    return sum(parts, ca.SX(0)) / len(seen)


@cache
def _harmonic() -> ca.Function:
    """`(q, level, u, height, up, along, a, b) -> reading` of one element; made once, it is called often."""
    names = ("q", "level", "u", "height", "up", "along", "a", "b")
    q, level, u, height, up, along, a, b = symbols = [ca.SX.sym(n) for n in names]
    cos, sin = ca.cos(q * u), ca.sin(q * u)
    value = ca.exp(-q * (height - level)) * (up * (a * cos + b * sin) - along * (a * sin - b * cos))
    return ca.Function("harmonic", symbols, [value])


# -- the closed form: 8 measurements, 6 coordinates ----------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Patch:
    """The sensors of one array: `rows` (2, n) take real and imaginary part of Z from the channels `which`.

    v_j = Re(Z exp(i k (s_j - middle))) with Z = a1 exp(i k u - k (height - level)) at the `middle` (x, y) of
    the patch on the board, where u and height are those of a level mover.
    """

    array: Array
    which: tuple[int, ...]
    middle: tuple[float, float]
    rows: np.ndarray


def patches(layout: Layout) -> tuple[Patch, ...]:
    """Return the patch of each array. Raises `InputError` where one has too few sensors."""
    out = []
    for name, array in arrays(layout).items():
        which = tuple(k for k, sensor in enumerate(sensors(layout)) if sensor.array == name)
        own = [sensors(layout)[k] for k in which]
        x, y = (float(np.mean([s.middle[i] for s in own])) if own else 0.0 for i in (0, 1))
        i, middle = array.axis, (x, y)
        turns = np.array(
            [np.mean(np.exp(1j * array.wavenumber * (np.array(s.positions)[:, i] - middle[i]))) for s in own]
        )
        rows = np.column_stack([turns.real, -turns.imag]) if own else np.zeros((0, 2))
        if len(own) < 2 or np.linalg.cond(rows) > MOST_ALIKE:
            raise InputError(
                f"Array {name} is seen by {len(own)} sensors at one place of its period; phase and "
                "height need two that are not half a wavelength apart; six coordinates take four such arrays."
            )
        out.append(Patch(array, which, middle, np.linalg.pinv(rows)))
    return tuple(out)


MOST_ALIKE = 100.0
"""Condition of the places of a patch in the period beyond which phase and amplitude are not separable."""


def measured(v: ca.SX, amplitude: ca.SX, layout: Layout) -> list[tuple[Patch, ca.SX, ca.SX]]:
    """Return of each patch a place along its array [m], -half a period to half, and its height [m].

    The place is that of the array's crest on the board, beside where it is for a mover at zero.
    """
    out = []
    for patch in patches(layout):
        array, i = patch.array, patch.array.axis
        re, im = ca.vertsplit(ca.DM(patch.rows) @ v[list(patch.which)])
        at_zero = array.wavenumber * (patch.middle[i] - array.centre[i])
        c, d = np.cos(at_zero), np.sin(at_zero)
        turn = ca.atan2(-(im * c - re * d) * ca.sign(amplitude), (re * c + im * d) * ca.sign(amplitude))
        size = ca.log((re**2 + im**2) / amplitude**2) / 2
        out.append((patch, turn / array.wavenumber, array.level_m - size / array.wavenumber))
    return out


def least_squares(layout: Layout) -> np.ndarray:
    """Return the rows (8, 6) of the measurements as linear functions of (x, y, z, rx, ry, rz): small angles.

    A patch at (x, y) of an array along x: place = x - rz y - (level - 1 / k) ry, height = z + rx y - ry x;
    along y: place = y + rz x + (level - 1 / k) rx. 1 / k is the field vector's turn into the board's axes.
    """
    rows = []
    for patch in patches(layout):
        (x, y), lever = patch.middle, patch.array.level_m - 1 / patch.array.wavenumber
        if patch.array.axis == 0:
            rows.append([1, 0, 0, 0, -lever, -y])
        else:
            rows.append([0, 1, 0, lever, 0, x])
        rows.append([0, 0, 1, y, -x, 0])
    return np.array(rows, dtype=float)


def seen_at(pose: ca.SX, patch: Patch) -> tuple[ca.SX, ca.SX]:
    """Return place and height of a patch, as `measured` gives them, for a pose of a rigid body: exact."""
    turn, i = links.rotation(*ca.vertsplit(pose[3:])), patch.array.axis
    m = turn.T @ (ca.vertcat(*patch.middle, 0) - pose[:3])
    along, up, lc = turn[2, i], turn[2, 2], 1 / patch.array.wavenumber
    return patch.middle[i] - m[i] - lc * along / up, -m[2] - lc * ca.log(along**2 + up**2) / 2


def begin(v: ca.SX, p: Mapping[str, ca.SX], layout: Layout) -> ca.SX:
    """Return the pose by the closed form: 8 measurements, least squares, the reference's place taken off.

    The places of parallel arrays differ by the yaw alone; each is taken on the branch of the first one. What
    the exact rigid body makes of the pose of small angles is taken off once, in least squares again: products
    of a yaw or tilt with the travel are some 50 um at 10 mrad.
    """
    wave = next(iter(arrays(layout).values())).wavelength_m
    first: dict[int, ca.SX] = {}
    rows, seen = [], measured(v, p["a1"], layout)
    for patch, place, height in seen:
        i = patch.array.axis
        if i in first:
            turns = (place - first[i]) / wave
            place = first[i] + wave * (turns - ca.floor(turns + 0.5))
        first.setdefault(i, place)
        rows += [place, height]
    solve = ca.DM(np.linalg.pinv(least_squares(layout)))
    small = solve @ ca.vertcat(*rows)
    exact = [value for patch, *_ in seen for value in seen_at(small, patch)]
    pose = ca.vertsplit(small + solve @ (ca.vertcat(*rows) - ca.vertcat(*exact)))
    rotations = [pose[3] - p["rx0"], pose[4] - p["ry0"], pose[5] - p["rz0"]]
    x, y = pose[0] - p["x0"], pose[1] - p["y0"]
    return ca.vertcat(x, y, pose[2], *rotations)


def onward(pose: np.ndarray, coordinate: str, values: Mapping[str, float]) -> np.ndarray:
    """Return how the pose (6, samples) changes per nominal metre along the mover's own x or y, (6, samples).

    Readings repeat when the mover goes on by a period along its own axes: a turned mover climbs with it.
    """
    rx, ry, rz = pose[3:]
    sx, cx, sy, cy, sz, cz = np.sin(rx), np.cos(rx), np.sin(ry), np.cos(ry), np.sin(rz), np.cos(rz)
    axes = {
        "x_m": (cz * cy, sz * cy, -sy),
        "y_m": (cz * sy * sx - sz * cx, sz * sy * sx + cz * cx, cy * sx),
    }
    out = np.zeros_like(pose)
    out[:3] = axes[coordinate]
    return out * links.scale_of(coordinate, values)


def guess(model: Model, log: Any) -> dict[str, float]:
    """Return amplitudes and the place of the reference, from a linear fit to some samples of a log.

    The logged pose taken as it is, the field of all arrays along one axis is a cosine and a sine.
    """
    layout = model.layout
    rows = np.unique(np.linspace(0, log.rows - 1, GUESSED).astype(int))
    pose = [log.array(c)[rows] for c in model.references]
    wide = {"a1": 1.0} | dict.fromkeys(("x0", "y0", "rx0", "ry0", "rz0"), 0.0)
    quarter = {a.axis: a.wavelength_m / 4 for a in arrays(layout).values()}
    state = np.zeros((len(model.state), len(rows)))
    found: dict[str, float] = {}
    size = []
    for axis, shift in quarter.items():
        own = [k for k, s in enumerate(sensors(layout)) if arrays(layout)[s.array].axis == axis]
        v = np.array([log.array(model.channels[k])[rows] for k in own])
        name = f"{'xy'[axis]}0"
        both = [
            model.readings(model.vector({**wide, name: by}), pose, state)[own].ravel() for by in (0.0, shift)
        ]
        if not np.isfinite(both).all():
            where = ", ".join(model.references)
            raise InputError(f"The field at the logged pose is not finite; look at the units of {where}.")
        (c, d), *_ = np.linalg.lstsq(np.array(both).T, v.ravel(), rcond=None)
        found[name] = float(np.arctan2(d, c)) * shift * 2 / np.pi
        size.append(float(np.hypot(c, d)))
    return {"a1": float(np.mean(size)), **found}


GUESSED = 400
"""Samples that the first guess is made from."""


# -- checks and machines described by a log ------------------------------------------------------------------


def check(layout: Layout) -> None:
    """Refuse a layout that does not tell six coordinates."""
    names = list(arrays(layout))
    for sensor in sensors(layout):
        if sensor.array not in names:
            raise InputError(
                f"Sensor {sensor.channel} must name its array, one of {', '.join(names) or 'none stated'}; "
                f"instead received {sensor.array!r}."
            )
    waves = {a.wavelength_m for a in arrays(layout).values()}
    if len(waves) > 1:
        raise InputError(f"The arrays of a mover must have one wavelength; instead received {sorted(waves)}.")
    for sensor in sensors(layout):
        check_channel(sensor, arrays(layout)[sensor.array])
    rows = least_squares(layout) if names else np.zeros((0, 6))
    rank = int(np.linalg.matrix_rank(rows * np.array([1, 1, 1, 0.1, 0.1, 0.1]), tol=1e-3))
    if rank < len(POSE):
        raise InputError(
            f"{len(names)} arrays tell {rank} of six coordinates; it takes two along x and two along y, "
            "apart from each other, or the model halbach for x and z."
        )


def pinwheel(wavelength_m: float = WAVELENGTH_M) -> Layout:
    """Return the thesis's mover: two arrays along x and two along y in a pinwheel, six columns under each."""
    w = wavelength_m
    far, near, third = 3.0 * w, 2.5 * w, w / 3
    centres = {"X1": (-near, far), "X2": (near, -far), "Y1": (far, near), "Y2": (-far, -near)}
    made = [Array(name, w, name[0].lower(), centre, 6 * w, 5 * w, w / 4) for name, centre in centres.items()]
    seen = []
    for array in made:
        i = array.axis
        for k in range(6):
            along = [(k - 2.5) * third * (i == j) + array.centre[j] for j in (0, 1)]
            across = [[0.0, (n - 1) * third] if i == 0 else [(n - 1) * third, 0.0] for n in range(3)]
            places = tuple((along[0] + dx, along[1] + dy) for dx, dy in across)
            kind = "col" if i == 0 else "row"
            seen.append(Sensor(f"{array.name.lower()}_{kind}_{k}_v", places, array.name))
    return (*seen, *made)


def from_meta(make: Callable[..., Model], meta: Meta) -> Model:
    """Return the model for the arrays and channels that a log, a machine file or a calibration states.

    Of a log's meta.json or a machine file the tables `arrays` and `channels` (or probes), and `lambda_m` of
    the nominal values.
    """
    nominal = {k: v for k, v in meta.nominal.items() if isinstance(v, int | float)}
    own = halbach_planar().names
    stated: Sequence[Mapping[str, Any]] = [
        *(meta.probes if meta.probes is not None else meta.raw.get("channels", ())),
        *map(with_ends, meta.raw.get("arrays", ())),
    ]
    about = {"thickness_m": nominal["magnet_thickness_m"]} if "magnet_thickness_m" in nominal else {}
    wave = float(nominal.get("lambda_m", WAVELENGTH_M))
    parts = [part_of(e if "channel" in e else {**about, **e}, wave) for e in stated]
    model = make(_settled(tuple(parts), meta)) if parts else make()
    changes = {k: {"nominal": float(v)} for k, v in nominal.items() if k in own}
    if "remanence_t" in nominal and "gain_v_per_t" in nominal:
        array = next(iter(arrays(model.layout).values()))
        changes.setdefault("a1", {"nominal": _amplitude(array, nominal)})
    return model.with_parameters(changes)


def _settled(layout: Layout, meta: Meta) -> Layout:
    """Return the layout with the travel of its log, in which a model has the ends; else without ends."""
    known, seen = arrays(layout), sensors(layout)
    if not known or not ended(layout) or any(s.array not in known for s in seen):
        return layout
    pose = meta.sample(REFERENCES)
    if len(pose) and not any(array.known_m for array in known.values()):
        level = Array("mover", 1.0)
        at = np.hstack([in_mover(Sensor(s.channel, (s.middle,)), level, pose)[0] for s in seen])
        at -= np.repeat([[*s.middle, 0.0] for s in seen], pose.shape[1], axis=0).T
        at[2] *= -1
        known = {n: replace(a, known_m=travel(a.wavelength_m, at)) for n, a in known.items()}
    layout = (*seen, *known.values())
    felt = not any(map(finite.beyond, known.values()))
    return layout if felt and finite.under(layout, 1) else (*seen, *(a.stated for a in known.values()))


def _amplitude(array: Array, nominal: Mapping[str, float]) -> float:
    """Nominal amplitude of the first harmonic at the level [V], after (2-3)."""
    face = nominal["gain_v_per_t"] * nominal["remanence_t"] * finite.filled(array, 1)
    return float(face * np.exp(-array.wavenumber * array.level_m))
