"""Words for people: names of columns, units that suit the size of the values, numbers with few digits."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from hallsym.units import fitting, readable, scaled, typeset

LEVEL = 1e-6
"""Vertical positions [m, rad] closer than this are one setting."""
NOT_DECODED = "the nominal parameters do not decode these readings"


def minus(text: str) -> str:
    """Return a number, or words with numbers, with true minus signs."""
    return re.sub(r"-(?=\.?\d)", "\N{MINUS SIGN}", text)


def micro(text: str) -> str:
    """Return words with the micro sign in units, `2 um`, `x [urad]`, and plus or minus as one sign.

    A line does not end between a number and its unit.
    """
    shown = re.sub(r"(\d |\[)u(?=(m|rad|V)\b)", r"\1µ", text).replace("+-", "\N{PLUS-MINUS SIGN}")
    return re.sub(r"(?<=\d) (?=(%|µ|deg\b|[mn]?(m|rad|V)\b))", "\N{NO-BREAK SPACE}", shown)


def name(column: str) -> str:
    """Return what people call a column: `rz_rad` is Rz, `hall_a_m` is Hall A."""
    stem = readable(column)[2] or column
    if stem.startswith("hall_"):
        return f"Hall {stem.removeprefix('hall_').upper()}"
    return stem.capitalize() if stem in ("z", "rx", "ry", "rz") else stem.replace("_", " ")


def scale(column: str, largest: float, periodic: Collection[str] | None = None) -> tuple[float, str]:
    """Return factor and printed unit for values of a column up to `largest`; `periodic` as in `readable`."""
    factor, unit = scaled(column, largest, periodic)
    return factor, typeset(unit)


def setting(
    columns: Sequence[str],
    point: np.ndarray,
    near: float | np.ndarray,
    periodic: Collection[str] | None = None,
) -> str:
    """Return `Z +250 Rx -500`, in um and urad, without values within `near` of zero."""
    parts = []
    for column, value, least in zip(columns, point, np.broadcast_to(near, len(columns)), strict=True):
        if abs(value) > least:
            shown = readable(column, periodic)[0] * value
            parts.append(f"{name(column)} {minus(f'{shown:+.{0 if abs(shown) >= 10 else 1}f}')}")
    return " ".join(parts) or "level"


def amount(column: str, value: float, periodic: Collection[str] | None = None) -> str:
    """Return a value of a column in the unit that suits it: `1.36 um`."""
    factor, unit = scaled(column, abs(value), periodic)
    return f"{number(factor * value)} {unit}"


def each(values: Mapping[str, float], periodic: Collection[str] | None = None) -> str:
    """Return `x 1.36 um, y 1.54 um, Rz 2.34 urad`; `periodic` as in `hallsym.units.readable`."""
    return ", ".join(f"{name(c)} {amount(c, v, periodic)}" for c, v in values.items())


def largest(values: np.ndarray) -> float:
    """Return the largest magnitude that is finite; 0 if there is none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size else 0.0


def number(value: float, digits: int = 3) -> str:
    """Return significant digits, with an exponent only for very large or small values, nothing for nan.

    >>> number(0.00123456), number(123456.0), number(2e-9), number(float("nan"))
    ('0.00123', '123000', '2e-09', '')
    """
    if np.isnan(value):
        return ""
    if value == 0 or not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits}g}"
    return np.format_float_positional(float(f"{value:.{digits}g}"), trim="-")


def sized(value: float, si: str, *, turns: bool = False, digits: int = 3) -> str:
    """Return a value with the unit that suits it: `0.606 nm`; `turns`: of a periodic angle."""
    factor, unit = fitting(si, value, turns=turns)
    return f"{number(value * factor, digits)} {unit}"
