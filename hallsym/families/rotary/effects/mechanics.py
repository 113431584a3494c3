"""Effects of an encoder at the mechanics: chip and magnet off the axis of rotation, and play."""

import casadi as ca
import numpy as np

from hallsym.families.parts import Make, P, add, free
from hallsym.families.play import stop_operator
from hallsym.families.rotary.effects.parts import REFERENCE, ahead, harmonic
from hallsym.model import Model, Parameter, Signals
from hallsym.model.derived import Computed, Stretch


def off_axis(effect: str, direction_rad: float, tilted: bool = False) -> Make:
    """Chip and magnet both off the axis of rotation, to second order in what they are off.

    Near the axis the field in the frame of the magnet is 1 + a |w|^2 + (a/2) w^2 for a displacement w of the
    chip from the magnet's axis: curl B = 0 leaves one curvature a, and the last one, c conj(w)^2, vanishes
    for a dipole. A chip at S exp(i direction) and a magnet at M make w = S exp(i (direction - u)) - M, which
    gives harmonics 2 and 0 by their product and -1 by the chip alone. A `tilted` magnet gives the same with
    other shares of both parts of harmonic 0, free within bounds: without harmonic 2 there is none.
    """

    def make(model: Model) -> Model:
        names = [f"{effect}_{part}" for part in ("both_re", "both_im", "chip")]
        cos, sin = float(np.cos(2 * direction_rad)), float(np.sin(2 * direction_rad))

        def step(s: Signals, p: P) -> None:
            re, im, chip = (p[n] for n in names)
            a, b = (p["mirrored"], p["turned"]) if tilted else (ca.SX(1), ca.SX(1))
            harmonic(s, 2, re, im)
            harmonic(s, 0, a * re + b * (re * cos - im * sin), -a * im + b * (re * sin + im * cos))
            harmonic(s, -1, chip * cos, chip * sin)

        new = free(names, 0.5, "1", "field off the axis")
        if tilted:
            shares = ("mirrored", "turned")
            new += tuple(
                Parameter(n, 0.5, -2.0, 3.0, "1", "part of harmonic 2 in harmonic 0") for n in shares
            )
        return add(model, "mechanics", effect, new, step)

    return make


def hysteresis(width_rad: float) -> Make:
    """The angle lags in the direction of motion by a constant, whatever the speed: play, magnetic memory."""

    def make(model: Model) -> Model:
        column = direction(width_rad)

        def step(s: Signals, p: P) -> None:
            ahead(s, -p["play"] * s[column.name])

        return add(
            model, "mechanics", "hysteresis", free(["play"], 0.5, "rad", "half the play"), step, column
        )

    return make


def direction(width_rad: float) -> Computed:
    """Return the direction of motion, -1 to 1, which turns over within `2 width_rad` after a reversal."""

    def rule(s: Stretch) -> np.ndarray:
        u = s.rate(REFERENCE, 0)
        z = stop_operator(u, width_rad)
        full = np.flatnonzero(np.abs(z) >= 1.0)
        if len(full):
            z[: full[0]] = z[full[0]]
        return z

    return Computed(f"direction_{width_rad:.6g}", (REFERENCE,), rule)
