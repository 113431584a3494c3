"""What to expect of the next devices: nominal values and bounds as a machine file, tolerances as a file."""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from hallsym.errors import InputError, counted
from hallsym.fleets.result import Fleet
from hallsym.fleets.spread import Spread

OUTSIDE = 1e-4
"""Probability that a parameter of a device of the same production lies outside the bounds."""
DIGITS = 9
"""Significant digits of what is written."""


def machine_file(fleet: Fleet) -> str:
    """Return the text of a machine file with nominal values and bounds for the next batch.

    Nominal: the mean of the devices. Bounds: what all but 1e-4 of the next devices lie within, for a spread
    at the upper end of its 95 % interval. Parameters that repeat are left out: mounting sets them.
    """
    lines = []
    for s in _known(fleet):
        low, high = s.mean - _reach(s), s.mean + _reach(s)
        lines += [f"[parameters.{s.name}]", f"nominal = {_short(s.mean)}", f"lower = {_short(low)}",
                  f"upper = {_short(high)}", ""]  # fmt: skip
    return "\n".join([f"# From {_devices(fleet)}; SI units.", "", *lines])


def tolerance_file(fleet: Fleet) -> str:
    """Return the text of a tolerance file for `hallsym tolerances`: the spread of each parameter, 1 sigma."""
    lines = [f"# From {_devices(fleet)}.", 'others = "exact"', "", "[tolerance]"]
    for s in _known(fleet):
        key = f"{s.name}_{_suffix(s.unit)}" if s.unit != "1" else s.name
        lines.append(f"{key} = {{ std = {_short(s.std)} }}" if s.std > 0 else f'{key} = "exact"')
    return "\n".join([*lines, ""])


def _known(fleet: Fleet) -> Sequence[Spread]:
    period = fleet.model.period if fleet.model else {}
    found = [s for s in fleet.spreads if s.name not in period]
    if not found:
        raise InputError(
            "No parameter has a spread to make bounds or tolerances from: three good devices at least must "
            "determine it."
        )
    return found


def _devices(fleet: Fleet) -> str:
    return counted(max(s.devices for s in fleet.spreads), "device")


def _reach(spread: Spread) -> float:
    """Half width of the bounds; an estimate, not only its truth, shall lie within them."""
    sigma = float(np.linalg.norm([spread.interval[1], spread.mean_std, spread.typical_std]))
    return -float(ndtri(OUTSIDE / 2)) * sigma


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _suffix(unit: str) -> str:
    return f"per_{unit.removeprefix('1/')}".lower() if unit.startswith("1/") else unit.lower()
