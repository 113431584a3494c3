"""Entries of a parameter table: their names and units, from the names of columns."""

from dataclasses import dataclass

from hallsym.codegen.naming import identifier


@dataclass(frozen=True, eq=False)
class Entry:
    """One number of the parameter table: `value` in SI, and what it means."""

    name: str
    value: float
    unit: str
    meaning: str


def short(column: str) -> str:
    """Return `hall_a` of `hall_a_m`, as a C identifier."""
    return identifier(column.rpartition("_")[0] or column)


def unit(column: str) -> str:
    """Return the SI unit of a column."""
    return {"m": "m", "rad": "rad", "degc": "degC", "s": "s", "v": "V"}.get(column.rpartition("_")[2], "1")


def per(base: str, label: str) -> str:
    """Unit of a coefficient: base per unit of the monomial."""
    powers: dict[str, int] = {}
    for column in filter(None, label.split("*")):
        powers[unit(column)] = powers.get(unit(column), 0) + 1
    if base in powers:
        powers[base] -= 1
        base = "1"
    below = "*".join(f"{u}{n if n > 1 else ''}" for u, n in powers.items() if n)
    return f"{base}/({below})" if "*" in below else f"{base}/{below}" if below else base
