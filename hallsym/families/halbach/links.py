"""What the links of both Halbach models pass on, and the waves of a periodic array.

Signals of the chain, beside the columns: `moved`: for each channel a dict of what is added to each logged
coordinate (clock, reference); `placed`: what is added to the position (x, y, z) [m] of its sensors; `tilted`:
the slopes (x, y) of their axes [rad]; `field`: the field that each channel sees [V]; `reading`.
"""

from collections.abc import Callable, Sequence

import casadi as ca

from hallsym.families.halbach.layout import sensors
from hallsym.families.mechanisms import P, Port, port
from hallsym.model import Model, Signals

LATER = "later"
"""Signal of the time [s] by which the field is taken later, where a link filters it."""


def begin(s: Signals, model: Model) -> None:
    """Set what effects move: nothing yet."""
    count = len(model.channels)
    s["moved"] = [dict.fromkeys(model.pose, ca.SX(0)) for _ in range(count)]
    s["placed"] = [[ca.SX(0)] * 3 for _ in range(count)]
    s["tilted"] = [[ca.SX(0)] * 2 for _ in range(count)]
    s["filters"] = []


def labels(model: Model) -> Sequence[str]:
    """Return the label of each channel."""
    return [sensor.label for sensor in sensors(model.layout)]


FIELD: Port = port("field", labels)
"""Field at each channel [V at a gain of 1]."""
READING: Port = port("reading", labels)
"""Each channel as it is read [V]."""


def move(s: Signals, coordinate: str, by: ca.SX | Sequence[ca.SX]) -> None:
    """Add to a coordinate of the pose, for all channels alike or one by one."""
    each = by if isinstance(by, list | tuple) else [by] * len(s["moved"])
    for moved, change in zip(s["moved"], each, strict=True):
        moved[coordinate] = moved[coordinate] + change


def filtered(s: Signals, p: P) -> None:
    """Take the field through the filters that effects have put in its way."""
    for low_pass in s["filters"]:
        s["field"] = low_pass(s["field"])


def read(s: Signals, p: P) -> None:
    """Set the reading of each channel."""
    s["gain"] = ca.SX.ones(s["field"].numel())
    s["reading"] = s["field"]


def turned(pair: tuple[ca.SX, ca.SX], angle: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return cos(u + angle), sin(u + angle) from the pair cos u, sin u."""
    cos, sin = ca.cos(angle), ca.sin(angle)
    return pair[0] * cos - pair[1] * sin, pair[1] * cos + pair[0] * sin


Wave = Callable[[int, int], tuple[ca.SX, ca.SX]]
"""`wave(channel, harmonic)`: fading cosine and sine of the place in the period, the mean of its elements."""
