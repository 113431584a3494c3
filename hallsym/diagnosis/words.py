"""Words of statements: shares in per cent, names of channels, places in the unit a person reads."""

UNITS = {"m": (1e6, "um"), "rad": (1e6, "urad"), "m/s": (1e3, "mm/s"), "v": (1e3, "mV"), "v/s": (1.0, "V/s")}
"""How places are shown to a person."""


def percent(share: float) -> str:
    """Return a share in per cent without digits."""
    return f"{100 * share:.0f} %"


def plain(channel: str) -> str:
    """Return the name of a column without its unit."""
    return channel.rpartition("_")[0] or channel


def shown(value: float, unit: str, *, sign: bool = False) -> str:
    """Return a value with the unit that a person reads."""
    factor, name = UNITS.get(unit, (1.0, unit))
    number = f"{value * factor:+.3g}" if sign and unit not in ("s", "degC") else f"{value * factor:.3g}"
    return f"{number} {name}"
