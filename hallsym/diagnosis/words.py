"""Words of statements: shares in per cent, names of channels, values in the unit a person reads, noise."""

from collections.abc import Sequence

from hallsym.estimation.goodness_of_fit import ResidualNoise
from hallsym.units import readable, reading_unit

SHOWN = 3
"""Names that are listed at most: signals to compute, other effects of a group."""


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


def gap_unit(outputs: Sequence[str]) -> tuple[float, str]:
    """Return factor and unit in which a person reads the gap metric over `outputs`: a length, or an angle."""
    return readable(next((name for name in outputs if name.endswith("_m")), outputs[0]))[:2]


def gap_text(gap: float, unit: tuple[float, str], digits: int = 3) -> str:
    """Return a gap with its unit, such as `1.23 um`."""
    return f"{gap * unit[0]:.{digits}g} {unit[1]}"


def noise_text(noise: ResidualNoise, stated: bool) -> str:
    """Return the noise in words."""
    low, high = noise.interval
    said = (
        f"{noise.ratio:.3g} x the {'stated' if stated else 'estimated'} noise (95 %: {low:.3g} to {high:.3g})"
    )
    if noise.larger and len(noise.by_sensor) > 1:
        everywhere = len(noise.larger_in) == len(noise.by_sensor)
        names = " and ".join(plain(c) for c in noise.larger_in)
        said += ", in every sensor" if everywhere else f", in {names} alone" if names else ""
    if noise.white:
        return f"{said}, white"
    return (
        f"{said}, correlated in time (neighbouring samples by {noise.correlation:.2f}; a slow average varies "
        f"{noise.memory:.3g} x as much as that of white noise)"
    )
