"""Effects of Halbach arrays at the mechanics, the clock and the reference: where sensors are, and when."""

import casadi as ca

from hallsym.errors import InputError
from hallsym.families.halbach import links
from hallsym.families.halbach.layout import arrays, sensors
from hallsym.families.halbach.links import rotation
from hallsym.families.mechanisms import P, free
from hallsym.model import Facts, Model, Signals, Way, effect
from hallsym.model.arguments import Try, beside, found, one_of
from hallsym.model.derived import rate

MOST_OFF_M, MOST_TILT_RAD, MOST_TURN_RAD, MOST_DELAY_S = 3e-3, 0.3, 0.1, 0.05
SHIFT = (
    "no recording shows a shift in {a} of all sensors beside that of the field: the mean of d{a}_* "
    "stays nominal; one with fixed = true in the machine file sets it instead"
)
"""Said where a fit leaves the mean place or height of the sensors nominal."""
FIFTH = Way("sweeps at a smaller gap", "the fifth harmonic sees a tilt and a place differently")


def _axes(model: Model) -> dict[str, str]:
    """Return of each channel the axis of the board along which its array's field changes."""
    known = arrays(model.layout)
    only = next(iter(known.values()))
    return {s.label: known.get(s.array, only).along for s in sensors(model.layout)}


@effect(link="mechanics", waves=(2,), separate=FIFTH)
def sensor_position_error(
    model: Model,
    along: str = one_of(
        {"period": "along the array", "space": "along the array and in height"},
        "directions in which sensors are off",
    ),
) -> Model:
    """Sensors are off their nominal pitch (board-fixed)."""
    axes = {k: (axis, "z") if along == "space" else (axis,) for k, axis in _axes(model).items()}
    meanings = {
        f"d{a}_{k}": f"{a} of sensor {k} beyond its nominal place" for k, own in axes.items() for a in own
    }

    def step(s: Signals, p: P) -> None:
        for k, (label, own) in enumerate(axes.items()):
            for a in own:
                place = s["placed"][k]
                place["xyz".index(a)] = place["xyz".index(a)] + p[f"d{a}_{label}"]

    new = free(meanings, MOST_OFF_M, "m")
    wide = model.with_step("mechanics", step, effect="sensor_position_error", parameters=new)
    for a in sorted({name[1] for name in meanings}):
        own = [n for n in meanings if n.startswith(f"d{a}_")]
        wide = wide.with_gauge(own, SHIFT.format(a=a))
    return wide


@effect(link="mechanics", waves=(2,), separate=FIFTH, label="each sensor")
def sensor_tilt(model: Model) -> Model:
    """Sensors are tilted against the board and read part of the field in its plane (board-fixed)."""
    axes = _axes(model)
    meanings = {f"tilt{a}_{k}": f"slope of the axis of sensor {k} towards {a}" for k, a in axes.items()}

    def step(s: Signals, p: P) -> None:
        for k, (label, a) in enumerate(axes.items()):
            s["tilted"][k]["xy".index(a)] = s["tilted"][k]["xy".index(a)] + p[f"tilt{a}_{label}"]

    new = free(meanings, MOST_TILT_RAD, "rad")
    return model.with_step("mechanics", step, effect="sensor_tilt", parameters=new)


PLACE, HEIGHT = "place", "height"
"""What of an array may be off: its place and turn, or only its height."""


def each_array(model: Model, facts: Facts) -> list[Try]:
    """Return one array after the other, the height of one after the other, then all."""
    names = list(arrays(model.layout))
    one = [Try({"array": name}, f"array {name}", tried=len(names)) for name in names]
    heights = [
        Try({"array": name, "only": HEIGHT}, f"height of array {name}", tried=len(names)) for name in names
    ]
    return [*one, *heights, Try({"array": "all"}, "all arrays")]


@effect(
    link="mechanics",
    separate=Way("the mover turned half round about z", "arrays turn with it, sensors do not"),
)
def array_geometry_error(
    model: Model,
    array: str = found(each_array, "name of the array that is off, or all"),
    only: str = beside(f"{PLACE}: place and turn, or {HEIGHT} only", default=PLACE),
) -> Model:
    """An array is displaced or turned on the mover against its nominal place (mover-fixed)."""
    known = list(arrays(model.layout))
    if array not in (*known, "all"):
        raise InputError(
            f"Array of array_geometry_error must be one of {', '.join(known)} or all; it is {array!r}."
        )
    if only not in (PLACE, HEIGHT):
        raise InputError(f"What is off in array_geometry_error must be {PLACE} or {HEIGHT}; it is {only!r}.")
    which = known if array == "all" else [array]
    off, about = ("xyz", "xyz") if only == PLACE else ("z", "")
    shifts = {f"d{a}_{n}": f"{a} of array {n} on the mover beyond its place" for n in which for a in off}
    turns = {f"r{a}_{n}": f"turn of array {n} on the mover about {a}" for n in which for a in about}

    def step(s: Signals, p: P) -> None:
        own = {n: p[n] for n in (*shifts, *turns)}
        for n in which:
            shift, angles = ([own.get(f"{k}{a}_{n}", ca.SX(0)) for a in "xyz"] for k in "dr")
            s["mounted"][n] = ca.vertcat(*shift), rotation(*angles)

    new = (*free(shifts, MOST_OFF_M, "m"), *free(turns, MOST_TURN_RAD, "rad"))
    return model.with_step("mechanics", step, effect="array_geometry_error", parameters=new)


@effect(
    link="clock",
    needs=("t_s",),
    separate=Way("the same motion at several speeds", "a lag lowers the amplitude, a delay does not"),
)
def time_skew(
    model: Model,
    per: str = one_of(
        {"log": "one delay", "channel": "a delay per channel"}, "one delay for the log or for each channel"
    ),
) -> Model:
    """Constant delay between readings and reference; a multiplexed converter has one per channel."""
    names = [f"delay_{k}" for k in links.labels(model)] if per == "channel" else ["delay"]
    columns = [rate(c, n) for n in (1, 2) for c in model.references]

    def step(s: Signals, p: P) -> None:
        for coordinate, column in zip(model.pose, model.references, strict=True):
            by: list[ca.SX] = [-p[n] * s[f"d1_{column}"] + p[n] ** 2 * s[f"d2_{column}"] / 2 for n in names]
            links.move(s, coordinate, by if per == "channel" else by[0])

    new = free(dict.fromkeys(names, "delay of the readings"), MOST_DELAY_S, "s")
    return model.with_columns(*columns).with_step("clock", step, effect="time_skew", parameters=new)


# -- at the reference --------------------------------------------------------------------------------------


def _off(model: Model, effect: str, terms: dict[str, tuple[str, str, str]], limit: float, unit: str) -> Model:
    """Logged coordinate = true + e column: `terms`: parameter -> coordinate, column, meaning."""

    def step(s: Signals, p: P) -> None:
        for name, (coordinate, column, _) in terms.items():
            links.move(s, coordinate, -p[name] * s[column])

    new = free({name: meaning for name, (_, _, meaning) in terms.items()}, limit, unit)
    return model.with_step("reference", step, effect=effect, parameters=new)


def _lengths(model: Model) -> list[str]:
    return [c for c in model.pose if c.endswith("_m")]


@effect(
    link="reference",
    label="a factor per length",
    separate="more periods; a known length beside the reference",
)
def reference_scale_error(model: Model) -> Model:
    """Scale factor of a reference axis."""
    terms = {
        f"scale_{c[0]}": (c, c, f"share by which the reference of {c[0]} is long") for c in _lengths(model)
    }
    return _off(model, "reference_scale_error", terms, 0.1, "1")


@effect(
    link="reference",
    label="each length with the other motions",
    separate="one coordinate moved while the rest stands still, beside a second reference",
)
def reference_abbe_error(model: Model) -> Model:
    """The reference reads other motions: tilt times an Abbe arm, an axis that is not square."""
    turns = [c for c in model.pose if c.endswith("_rad")]
    lengths = _lengths(model)
    pairs = [(c, t) for c in lengths for t in (turns or [o for o in lengths if o != c])]
    terms = {
        f"abbe_{c[0]}_{t.split('_')[0]}": (c, t, f"error of the reference of {c[0]} per {t.split('_')[0]}")
        for c, t in pairs
    }
    return _off(model, "reference_abbe_error", terms, 1.0, "m/rad" if turns else "1")
