"""Words of statements: shares in per cent, names of channels, places in the unit a person reads."""

from collections.abc import Iterable

from hallsym.units import readable, reading_unit

SHOWN = 3
"""Names that are listed at most: signals to compute, other effects of a group."""


def percent(share: float) -> str:
    """Return a share in per cent without digits."""
    return f"{100 * share:.0f} %"


def plain(channel: str) -> str:
    """Return the name of a column without its unit."""
    return channel.rpartition("_")[0] or channel


def place_unit(unit: str) -> tuple[float, str]:
    """Return factor and unit in which a place along a coordinate is read; time stays in seconds."""
    return (1.0, unit) if unit == "s" else reading_unit(unit)


def shown(value: float, unit: str) -> str:
    """Return a value with the unit that a person reads."""
    factor, name = place_unit(unit)
    return f"{value * factor:.3g} {name}"


def gap_unit(outputs: Iterable[str]) -> tuple[float, str]:
    """Return factor and unit in which a person reads the gap metric over `outputs`: a length, or an angle."""
    names = list(outputs)
    factor, unit, _ = readable(next((n for n in names if n.endswith("_m")), names[0] if names else "x_m"))
    return factor, unit


def gap_text(gap: float, unit: tuple[float, str], digits: int = 3) -> str:
    """Return a gap with its unit, such as `1.23 um`."""
    return f"{gap * unit[0]:.{digits}g} {unit[1]}"
