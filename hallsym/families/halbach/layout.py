"""The machine of a Halbach array: arrays of magnets on the mover, Hall sensors on the board.

A model's layout is a tuple of `Sensor`s, one per channel, followed by the `Array`s. A saved calibration and
a machine file state them entry by entry (`entry`, `part_of`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np

from hallsym.errors import InputError

USUAL_TRAVEL, USUAL_GAPS = 0.7, (0.1, 0.45)
"""Travel to both sides and gaps, in wavelengths, of a machine of which no log says them."""
LEAKS = 0.02
"""Share of the field of a crossing array that sums of sensors may leave: that of a pitch 0.8 % off."""


@dataclass(frozen=True)
class Sensor:
    """What one channel reads: the mean of its elements, each at (x, y) [m] on the board, y = 0 if left out.

    `array`: name of the array that stands over it; "" for the only one.
    """

    channel: str
    positions: tuple[tuple[float, float], ...]
    array: str = ""

    @property
    def label(self) -> str:
        """Name in parameters and messages: 3 of col_3_v, 0_18 of hall_0_18_v."""
        return re.sub(r"^(col|hall)_|_v$", "", self.channel)

    @property
    def entry(self) -> dict[str, Any]:
        """The sensor as a saved calibration describes it."""
        stated = {"channel": self.channel, "positions_m": [list(p) for p in self.positions]}
        return stated | ({"array": self.array} if self.array else {})

    @property
    def middle(self) -> tuple[float, float]:
        """Mean position of its elements (x, y) [m]."""
        x, y = np.mean(self.positions, axis=0)
        return float(x), float(y)


@dataclass(frozen=True)
class Array:
    """Magnets on the mover that repeat every `wavelength_m` along one axis.

    `centre`: on the mover, (x, y) [m]. `thickness_m`: height of the magnets, by default that of square ones.
    `level_m`: gap at which amplitudes are stated.

    `ends`: whether a model has the ends of the array. `middle_magnet`: which magnet is at its middle, in half
    magnets from the one that points to the sensors; odd: the border of two. `known_m`: least and greatest x
    (of six coordinates also y) and gap over which a model has the ends and maps magnets; empty for the usual
    travel.
    `middle_m`: place of its middle beside its centre when the mover is at zero. `rival`: by how many half
    magnets another one may be in the middle, which a log tells hardly from it; 0: none.
    """

    name: str
    wavelength_m: float
    along: str = "x"
    centre: tuple[float, float] = (0.0, 0.0)
    length_m: float = 0.24
    width_m: float = 0.15
    thickness_m: float = 0.0
    magnets_per_period: int = 4
    level_m: float = 5e-3
    ends: bool = False
    middle_magnet: int = 0
    known_m: tuple[float, ...] = ()
    middle_m: float = 0.0
    rival: int = 0

    @property
    def label(self) -> str:
        """Name in messages."""
        return self.name

    @property
    def entry(self) -> dict[str, Any]:
        """The array as a saved calibration describes it."""
        return {
            "name": self.name, "periodic_along": self.along, "centre_m": list(self.centre),
            "length_m": self.length_m, "width_m": self.width_m, "wavelength_m": self.wavelength_m,
            "thickness_m": self.thickness_m, "magnets_per_period": self.magnets_per_period,
            "level_m": self.level_m, "ends": self.ends, "middle_magnet": self.middle_magnet,
            "known_m": list(self.known_m), "middle_m": self.middle_m, "rival": self.rival,
        }  # fmt: skip

    @property
    def stated(self) -> Array:
        """The array as a file states it, without what a log says of it."""
        return replace(self, ends=False, middle_magnet=0, known_m=(), middle_m=0.0, rival=0)

    @property
    def middle(self) -> float:
        """Place of its middle along it when the mover is at zero [m]."""
        return self.centre[self.axis] + self.middle_m

    @property
    def other(self) -> Array:
        """The array with its rival in the middle."""
        step = self.rival * self.wavelength_m / self.magnets_per_period / 2
        return replace(
            self, middle_magnet=self.middle_magnet + self.rival, middle_m=self.middle_m + step, rival=0
        )

    def box(self, plane: int = 1) -> np.ndarray:
        """Return least and greatest of one or two coordinates `plane` and of the gap, (plane + 1, 2) [m]."""
        usual = [*(plane * [-USUAL_TRAVEL, USUAL_TRAVEL]), *USUAL_GAPS]
        return np.array(self.known_m or [self.wavelength_m * v for v in usual]).reshape(plane + 1, 2)

    @property
    def under(self) -> tuple[float, float]:
        """How far sensors go along it from where they are at zero [m]; half a wavelength if unknown."""
        if not self.known_m:
            return -self.wavelength_m / 2, self.wavelength_m / 2
        if len(self.known_m) == 4:  # of the mover, against which the sensors go
            return -self.known_m[1], -self.known_m[0]
        low, high = self.box(2)[self.axis].tolist()
        return low, high

    @property
    def wavenumber(self) -> float:
        """2 pi over the wavelength [rad/m]."""
        return 2 * pi / self.wavelength_m

    @property
    def height(self) -> float:
        """Height of the magnets [m]; of square ones if none is stated."""
        return self.thickness_m or self.wavelength_m / self.magnets_per_period

    @property
    def axis(self) -> int:
        """0 for an array periodic along x, 1 along y."""
        return "xy".index(self.along)


Layout = tuple[Sensor | Array, ...]


def sensors(layout: Sequence[Sensor | Array]) -> tuple[Sensor, ...]:
    """Return the sensors of a layout, one per channel."""
    return tuple(part for part in layout if isinstance(part, Sensor))


def arrays(layout: Sequence[Sensor | Array]) -> dict[str, Array]:
    """Return the arrays of a layout by name."""
    return {part.name: part for part in layout if isinstance(part, Array)}


def opposite(layout: Layout, array: Array) -> Array:
    """Return the array that stands where `array` stood when the mover has turned half round about z.

    Raises `LookupError` where there is none.
    """
    for other in arrays(layout).values():
        away = np.abs(np.add(other.centre, array.centre)).max()
        if other.axis == array.axis and away < array.wavelength_m / 4:
            return other
    raise LookupError(array.name)


def columns(
    places: Sequence[float], wavelength_m: float = 0.03, names: Sequence[str] = (), **about: Any
) -> Layout:
    """Return one array over column sums at `places` [m] along it; `about`: fields of the `Array`."""
    channels = names or [f"col_{k}_v" for k in range(len(places))]
    rows = [Sensor(c, ((float(x), 0.0),)) for c, x in zip(channels, places, strict=True)]
    return (*rows, Array("X", wavelength_m, **about))


def part_of(entry: Mapping[str, Any], wavelength_m: float | None = None) -> Sensor | Array:
    """Return the sensor or array that an entry of a file states. Raises `InputError` for another form."""
    if "channel" in entry:
        places = entry.get("positions_m", [entry.get("position_m")])
        try:
            points = tuple(_point(place) for place in places)
        except (TypeError, ValueError):
            points = ()
        if not points:
            raise InputError(
                "A sensor must have 'channel' and 'positions_m' = [[x, y], ...] or 'position_m' = [x]; "
                f"instead received {dict(entry)!r}."
            )
        return Sensor(str(entry["channel"]), points, str(entry.get("array", "")))
    wrong = [key for key in entry if key not in Array("", 1.0).entry]
    along = entry.get("periodic_along", "x")
    if wrong or along not in ("x", "y"):
        said = f"it has '{wrong[0]}'" if wrong else f"periodic_along is {along!r}"
        raise InputError(
            "An array may have name, periodic_along (x or y), centre_m, length_m, width_m, wavelength_m, "
            f"thickness_m, magnets_per_period, level_m, ends and middle_magnet; {said}."
        )
    for key, kind, said in (("ends", bool, "true or false"), ("middle_magnet", int, "a whole number")):
        if key in entry and type(entry[key]) is not kind:
            raise InputError(f"Key '{key}' of an array must be {said}; instead received {entry[key]!r}.")
    stated = {key: _positive(entry[key], key) for key in _SIZES if key in entry}
    stated.setdefault("wavelength_m", 0.03 if wavelength_m is None else wavelength_m)
    centre = entry.get("centre_m", (0.0, 0.0))
    return Array(
        str(entry.get("name", along.upper())), along=along, centre=_point(centre),
        magnets_per_period=int(entry.get("magnets_per_period", 4)), ends=entry.get("ends") is True,
        middle_magnet=int(entry.get("middle_magnet", 0)), known_m=tuple(entry.get("known_m", ())),
        middle_m=float(entry.get("middle_m", 0.0)), rival=int(entry.get("rival", 0)), **stated,
    )  # fmt: skip


_SIZES = ("length_m", "width_m", "wavelength_m", "thickness_m", "level_m")


def _point(place: Any) -> tuple[float, float]:
    x, *rest = place if isinstance(place, list | tuple) else [place]
    return float(x), float(rest[0]) if rest else 0.0


def _positive(value: Any, key: str) -> float:
    good = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
    if not good or value < 0 or (value == 0 and key != "thickness_m"):
        raise InputError(f"Key '{key}' of an array must be a positive number; instead received {value!r}.")
    return float(value)


def check_sums(count: int, pitch_m: float, wavelength_m: float) -> None:
    """Raise `InputError` where sums of `count` sensors at a pitch leave the field of a crossing array."""
    what = f"Sums of {count} sensors at a pitch of {1e3 * pitch_m:g} mm"
    _check(what, pitch_m * np.arange(count), wavelength_m)


def check_channel(sensor: Sensor, array: Array) -> None:
    """Raise `InputError` where the sensors of a channel leave the field of an array that crosses theirs."""
    what = f"The {len(sensor.positions)} sensors of channel {sensor.channel}"
    _check(what, np.array(sensor.positions)[:, 1 - array.axis], array.wavelength_m)


def _check(what: str, across: np.ndarray, wavelength_m: float) -> None:
    left = abs(np.mean(np.exp(2j * pi / wavelength_m * across)))
    if np.ptp(across) > 0 and left > LEAKS:
        raise InputError(
            f"{what} leave {100 * left:.0f} % of the field of an array that crosses (wavelength "
            f"{1e3 * wavelength_m:g} mm); sum sensors over whole wavelengths, such as three at "
            f"{1e3 * wavelength_m / 3:g} mm."
        )
