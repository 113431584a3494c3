"""Words in pictures: names of columns, units that suit the size of the values, numbers with few digits."""

from collections.abc import Sequence

import numpy as np

from hallsym.units import readable

LEVEL = 1e-6
"""Vertical positions [m, rad] closer than this are one setting."""
MINUS = "\N{MINUS SIGN}"
_PREFIXES = ("n", "µ", "m", "")
_MOST = {"µ": 2e4, "m": 500.0}
"""Values above this are shown with the next larger prefix, below `_LEAST` with the next smaller one."""
_LEAST = 0.02
_SMALL_DEG = 0.5
"""Degrees up to this are shown in mdeg."""


def name(column: str) -> str:
    """What people call a column: `rz_rad` is Rz, `hall_a_m` is Hall A."""
    stem = readable(column)[2] or column
    if stem.startswith("hall_"):
        return f"Hall {stem.removeprefix('hall_').upper()}"
    return stem.capitalize() if stem in ("z", "rx", "ry", "rz") else stem.replace("_", " ")


def unit(column: str) -> str:
    """Unit of a column in the text tables, typeset: µm, µrad, mV, °C."""
    plain = readable(column)[1]
    if plain == "degC":
        return "°C"
    return "µ" + plain[1:] if plain in ("um", "urad") else plain


def scale(column: str, largest: float) -> tuple[float, str]:
    """Factor and unit for values of a column up to `largest`: those of the text tables if near it."""
    factor, shown = readable(column)[0], unit(column)
    if factor == 1.0:
        return factor, shown
    if shown == "deg":
        return (1e3 * factor, "mdeg") if 0 <= largest * factor <= _SMALL_DEG else (factor, shown)
    prefix, base = shown[0], shown[1:]
    if 0 <= largest * factor <= _LEAST and prefix == "µ":
        return 1e3 * factor, "n" + base
    while prefix and largest * factor > _MOST[prefix]:
        prefix, factor = _PREFIXES[_PREFIXES.index(prefix) + 1], factor / 1e3
    return factor, prefix + base


def setting(
    columns: Sequence[str], point: np.ndarray, near: float | np.ndarray, *, units: bool = False
) -> str:
    """`Z +250 Rx -500`, in um and urad; what is within `near` of zero is left out."""
    parts = [
        f"{name(c)} {factor * v:+.{0 if abs(factor * v) >= 10 else 1}f}".replace("-", MINUS)
        + (f" {unit(c)}" if units else "")
        for c, v, least in zip(columns, point, np.broadcast_to(near, len(columns)), strict=True)
        for factor in (readable(c)[0],)
        if abs(v) > least
    ]
    return " ".join(parts) or "level"


def largest(values: np.ndarray) -> float:
    """Largest magnitude that is finite; 0 if there is none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def short(value: float) -> str:
    """Three significant digits without an exponent, with one where there would be many zeros."""
    if value == 0 or not np.isfinite(value) or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.3g}"
    return np.format_float_positional(float(f"{value:.3g}"), trim="-")


def three(value: float) -> str:
    """Three significant digits, trailing zeros kept."""
    if 100 <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:#.3g}" if 1e-4 <= abs(value) < 100 else f"{value:.3g}"


def plus_minus(value: float, half: float, unit: str) -> str:
    """`value ± half` with two digits of `half`; metres in mm, radians in mrad."""
    factor, unit = {"m": (1e3, " mm"), "rad": (1e3, " mrad"), "1": (1.0, "")}.get(unit, (1.0, f" {unit}"))
    value, half = factor * value, factor * half
    if not (np.isfinite(half) and half > 0):
        return f"{value:.6g}{unit}"
    digits = int(np.clip(1 - np.floor(np.log10(half)), 0, 12))
    return f"{value:.{digits}f} ± {half:.{digits}f}{unit}".replace("-", MINUS)


def thinned(n: int, most: int) -> Sequence[int]:
    """Every k-th of n indices, k from 1, 2, 5, 10, .., at most about `most` of them."""
    step = next(s * 10**e for e in range(12) for s in (1, 2, 5) if n <= most * s * 10**e)
    return range(0, n, step)
