"""What the links of both Halbach models pass on, and the waves of a periodic array.

Signals of the chain, beside the columns: `moved`: for each channel a dict of what is added to each logged
coordinate (clock, reference); `placed`: what is added to the position (x, y, z) [m] of its sensors; `tilted`:
the slopes (x, y) of their axes [rad]; `mounted`: shift [m] and rotation of each array from its place;
`stretch`: share by which wavelengths are long; `turn`: -1 where the mover is turned half round about z, else
1; `field`: what each channel sees [V]; `reading`.
`crest`: place [m] along an array where the first harmonic points to the sensors, `amplitude`: of it at the
level [V]; `waves`: of the harmonics that have been asked for.
Functions: `seen(s, channel)`: what each of its elements sees (`Seen`), `harmonic(s, channel, h, a, b)`: its
reading of a cos + b sin of harmonic h.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import casadi as ca

from hallsym.families.halbach.layout import Array, arrays, sensors
from hallsym.families.mechanisms import P, Port, port
from hallsym.model import Model, Signals

LATER, FILTER = "later", "filter"
"""Time [s] by which the field is taken later where a link filters it, and the function (field) that does."""


def begin(s: Signals, model: Model) -> None:
    """Set what effects move: nothing yet."""
    count = len(model.channels)
    s["moved"] = [dict.fromkeys(model.pose, ca.SX(0)) for _ in range(count)]
    s["placed"] = [[ca.SX(0)] * 3 for _ in range(count)]
    s["tilted"] = [[ca.SX(0)] * 2 for _ in range(count)]
    s["mounted"] = {n: (ca.SX.zeros(3), rotation(*[ca.SX(0)] * 3)) for n in arrays(model.layout)}
    s["stretch"] = ca.SX(0)
    s["turn"] = 1


def labels(model: Model) -> Sequence[str]:
    """Return the label of each channel."""
    return [sensor.label for sensor in sensors(model.layout)]


FIELD: Port = port("field", labels)
"""Field at each channel [V at a gain of 1]."""
READING: Port = port("reading", labels)
"""Each channel as it is read [V]."""


def move(s: Signals, coordinate: str, by: ca.SX | Sequence[ca.SX]) -> None:
    """Add to a coordinate of the pose, for all channels at once or one by one."""
    each = by if isinstance(by, list | tuple) else [by] * len(s["moved"])
    for moved, change in zip(s["moved"], each, strict=True):
        moved[coordinate] = moved[coordinate] + change


def filtered(s: Signals, p: P) -> None:
    """Take the field through the filter that an effect has put in its way."""
    if FILTER in s.functions:
        s["field"] = s.functions[FILTER](s, s["field"])


def read(s: Signals, p: P) -> None:
    """Set the reading of each channel."""
    s["gain"] = ca.SX.ones(s["field"].numel())
    s["reading"] = s["field"]


def scale_of(coordinate: str, values: Mapping[str, float]) -> float:
    """Return the period of a coordinate as logged over the nominal one: of the magnets and the reference."""
    return (1 + values.get("longer", 0.0)) / (1 - values.get(f"scale_{coordinate[0]}", 0.0))


def rotated(pair: tuple[ca.SX, ca.SX], angle: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return cos(u + angle), sin(u + angle) from the pair cos u, sin u."""
    cos, sin = ca.cos(angle), ca.sin(angle)
    return pair[0] * cos - pair[1] * sin, pair[1] * cos + pair[0] * sin


@dataclass(frozen=True, eq=False)
class Seen:
    """What an element of a channel sees of an array: the place `u` along its period, its `height` below it.

    `across`: its place from the centre line. `up`, `along`, `aside`: components of the sensor's axis away
    from the magnets' face, along the period and across it.
    """

    array: Array
    u: ca.SX
    height: ca.SX
    up: ca.SX
    along: ca.SX
    across: ca.SX | float = 0.0
    aside: ca.SX | float = 0.0

    @cached_property
    def known(self) -> dict[ca.Function, ca.SX]:
        """What the element reads of fields, by their function: effects of one field share its expressions."""
        return {}


def middle(elements: Sequence[Seen]) -> Seen:
    """Return what is in the middle of elements under one array."""
    if len(elements) == 1:
        return elements[0]
    mean = {f.name: sum(getattr(e, f.name) for e in elements) / len(elements) for f in fields(Seen)[1:]}
    return Seen(elements[0].array, **mean)


def rotation(rx: ca.SX, ry: ca.SX, rz: ca.SX) -> ca.SX:
    """Return Rz Ry Rx (3, 3)."""
    (cx, sx), (cy, sy), (cz, sz) = ((ca.cos(a), ca.sin(a)) for a in (rx, ry, rz))
    return ca.vertcat(
        ca.horzcat(cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
        ca.horzcat(sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
        ca.horzcat(-sy, cy * sx, cy * cx),
    )
