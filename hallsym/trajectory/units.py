"""Numbers with a unit, such as 0.05um: lengths, angles and times, to SI."""

from __future__ import annotations

import math
import re

from hallsym.errors import InputError

UNITS: dict[str, tuple[str, float]] = {
    "pm": ("m", 1e-12), "nm": ("m", 1e-9), "um": ("m", 1e-6), "µm": ("m", 1e-6), "mm": ("m", 1e-3),
    "cm": ("m", 1e-2), "m": ("m", 1.0),
    "nrad": ("rad", 1e-9), "urad": ("rad", 1e-6), "mrad": ("rad", 1e-3), "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180), "arcsec": ("rad", math.pi / 648000),
    "us": ("s", 1e-6), "ms": ("s", 1e-3), "s": ("s", 1.0), "min": ("s", 60.0),
}  # fmt: skip
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def quantity(text: str, what: str, unit: str) -> float:
    """Return a positive number with its unit in SI; `what` names it in errors, `unit` is m, rad or s."""
    match = re.fullmatch(rf"({NUMBER})\s*([A-Za-zµ]+)", text.strip())
    known = [name for name, (si, _) in UNITS.items() if si == unit and name.isascii()]
    if not match or UNITS.get(match[2], ("",))[0] != unit or not 0 < float(match[1]) < math.inf:
        raise InputError(
            f"{what} must be a positive number with its unit ({', '.join(known)}), such as "
            f"{'0.05um' if unit == 'm' else '1ms' if unit == 's' else '2urad'}; instead received {text!r}."
        )
    return float(match[1]) * UNITS[match[2]][1]


def scaled(text: str) -> float | None:
    """Return a number with an optional unit in SI, or None if the text is something else."""
    match = re.fullmatch(rf"({NUMBER})\s*([A-Za-zµ]*)", text.strip())
    if not match or (match[2] and match[2] not in UNITS):
        return None
    return float(match[1]) * (UNITS[match[2]][1] if match[2] else 1.0)


def column(name: str) -> tuple[str, float] | None:
    """Return SI name and factor of a column: `x_um` gives ("x_m", 1e-6); None without a unit."""
    stem, _, unit = name.strip().rpartition("_")
    if not stem or unit not in UNITS:
        return None
    si, factor = UNITS[unit]
    return f"{stem}_{si}", factor
