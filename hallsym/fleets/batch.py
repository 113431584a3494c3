"""What to expect of the next devices: nominal values and bounds as a machine file, tolerances as a file."""

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from hallsym.errors import InputError, counted
from hallsym.fleets.result import Fleet
from hallsym.fleets.spread import Spread

OUTSIDE = 1e-4
"""Share of the next devices whose estimate of a parameter may lie outside its bounds."""
DIGITS = 9
"""Significant digits of what is written."""


def machine_file(fleet: Fleet) -> str:
    """Return the text of a machine file with nominal values and bounds for the next batch.

    Nominal: the mean of the devices. Bounds: a tolerance interval, which holds 9,999 of 10,000 next devices
    or more with a confidence of 95 %. Parameters that repeat are left out: mounting sets them.
    """
    lines = []
    for s in _known(fleet):
        low, high = bounds(s)
        lines += [f"[parameters.{s.name}]", f"nominal = {_short(s.mean)}", f"lower = {_short(low)}",
                  f"upper = {_short(high)}", ""]  # fmt: skip
    return "\n".join([f"# From {_devices(fleet)}; SI units.", "", *lines])


def bounds(spread: Spread) -> tuple[float, float]:
    """Return what the estimates of the next devices lie between but for `OUTSIDE` of them: in 95 % of fleets.

    In 97.5 %, by the upper end of the interval of their spread, less the 1 % in which a good device was taken
    for an outlying one.

    W. G. Howe, J. Am. Stat. Assoc. 64 (1969) 610, doi:10.2307/2283644: the normal quantile times the upper
    confidence limit of the standard deviation, which is also that of the mean about which it is taken.
    """
    sigma = float(np.hypot(spread.interval[1], spread.typical_std)) * (1.0 + 1.0 / spread.devices) ** 0.5
    reach = -float(ndtri(OUTSIDE / 2)) * sigma
    return spread.mean - reach, spread.mean + reach


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


def _short(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _suffix(unit: str) -> str:
    return f"per_{unit.removeprefix('1/')}".lower() if unit.startswith("1/") else unit.lower()
