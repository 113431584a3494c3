"""Choices, weights and quotients of steps, in the form that an arithmetic has them.

In floating point a choice is a comparison and a quotient a division. Integers take the lesser and the greater
of two, whose ranges are known, and a quotient by the logarithm of the divisor, which may vary by any ratio.
"""

from math import log, sqrt

import casadi as ca

from hallsym.codegen.lowering.wave_steps import Collected, Pair

BEYOND = 1.5
"""Times what poses of the box reach: where integers hold a value whose range is not known otherwise."""
HELD = 1.25
"""Times the longest phasor of the box, within which integers hold its parts: their powers need bits."""
ROUNDED = 1e-3
"""Room for rounding beyond the ends of a logarithm."""


def at_least(made: Collected, value: ca.SX, low: ca.SX) -> ca.SX:
    """Return the greater of two."""
    return ca.fmax(value, low) if made.native else ca.if_else(value > low, value, low)


def at_most(made: Collected, value: ca.SX, high: ca.SX) -> ca.SX:
    """Return the lesser of two."""
    return ca.fmin(value, high) if made.native else ca.if_else(value < high, value, high)


def above_minus(made: Collected, value: ca.SX, end: ca.SX) -> ca.SX:
    """Return the greater of a value and -end."""
    return ca.fmax(value, -end) if made.native else ca.if_else(value > -end, value, -end)


def smooth_weight(made: Collected, depth: ca.SX, name: str) -> ca.SX:
    """Add the steps of w^2 (3 - 2 w), w = `depth` between 0 and 1; returns it."""
    if made.native:  # about 1/2, where ranges tell that it is hardly more than 1
        side = made.step(f"share_{name}", ca.fmin(ca.fmax(depth, 0.0), 1.0) - 0.5)
        return made.step(f"weight_{name}", side * (1.5 - (side * side + side * side)) + 0.5)
    # 0 to 1 without a branch: its rounding is a millionth of a weight
    share = made.step(f"share_{name}", (ca.fabs(depth) - ca.fabs(depth - 1.0) + 1.0) * 0.5)
    return made.step(f"weight_{name}", share * share * (3.0 - (share + share)))


def period_count(made: Collected, count: ca.SX, tag: str, periods: int) -> ca.SX:
    """Return a count of periods, held where readings of no pose could make it anything."""
    if made.native:  # what says the period is held: its range bounds the count
        return count
    most = 2.0 * periods
    return made.step(f"counted{tag}", ca.if_else(count < 0.0, 0.0, ca.if_else(count > most, most, count)))


def held_logarithm(
    made: Collected, value: ca.SX, name: str, ends: tuple[float, float], unit: str, tag: str = ""
) -> ca.SX:
    """Add the logarithm, in integers, of a value held between `ends` [unit]; returns it."""
    for side, end in zip(("smallest", "largest"), ends, strict=True):
        if f"{side}_{name}" not in made.symbols:
            made.entry(f"{side}_{name}", end, unit, f"{side} value of {name}")
    low, high = (made.symbols[f"{side}_{name}"] for side in ("smallest", "largest"))
    return made.step(f"log_{name}{tag}", ca.log(ca.fmin(ca.fmax(value, low), high)))


def inverse(made: Collected, log_of: ca.SX, name: str, ends: tuple[float, float], unit: str) -> ca.SX:
    """Add the steps of 1 / a value in integers, from its `held_logarithm`; returns it.

    The exponential of the distance from the logarithm in the middle of the ends.
    """
    middle = sqrt(ends[0] * ends[1])
    level = made.entry(f"log_{name}_middle", log(middle), "1", f"logarithm of {name} in the middle")
    per = made.entry(f"per_{name}_middle", 1 / middle, f"1/{unit}", f"1 over {name} in the middle")
    reach = log(ends[1] / ends[0]) / 2 * (1 + ROUNDED)  # known, but not to an analysis of the C
    away = made.held(level - log_of, f"farthest_log_{name}", reach, "1", f"from the logarithm of {name}")
    return made.step(f"per_{name}", per * made.step(f"ratio_{name}", ca.exp(away)))


def logarithm_of_ratio(
    made: Collected, wide: Pair, log_cover: ca.SX, least: float, names: tuple[str, str]
) -> ca.SX:
    """Add the steps of the logarithm of a phasor in integers; returns it.

    `wide` is as many times the phasor as a cover; `least`: its least length where no flag is set; `names`: of
    the logarithm and of what the flag looks at.
    """
    name, inside = names
    made.least[f"{name}_wide"] = least
    total = made.step(f"{name}_wide", ca.log(ca.hypot(*wide)))
    found = made.step(name, total - log_cover, "[1] of the length of the phasor")
    made.step(inside, -ca.fabs(found), "[1] from the middle height, below zero")
    return found
