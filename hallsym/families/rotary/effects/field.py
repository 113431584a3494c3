"""Effects of an encoder in the field at the chip: harmonics of the magnet and soft compression."""

from collections.abc import Sequence

import casadi as ca

from hallsym.families.parts import Make, P, add, free
from hallsym.families.rotary.effects.parts import harmonic
from hallsym.model import Model, Signals


def field_harmonics(effect: str, link: str, orders: Sequence[int], phase: bool = True) -> Make:
    """Harmonics of the field at the chip, each with a free amplitude and (if `phase`) a free phase."""

    def make(model: Model) -> Model:
        parts = ("re", "im") if phase else ("re",)
        names = [f"{effect}_{n}_{part}".replace("-", "m") for n in orders for part in parts]

        def step(s: Signals, p: P) -> None:
            values = iter(names)
            for n in orders:
                re = p[next(values)]
                harmonic(s, n, re, p[next(values)] if phase else ca.SX(0))

        return add(model, link, effect, free(names, 0.5, "1", "harmonic of the field"), step)

    return make


def field_saturation(model: Model) -> Model:
    """Each plate compresses softly, alike: b becomes b - k b^3."""
    name = "compression"

    def step(s: Signals, p: P) -> None:
        for plate in ("cosine", "sine"):
            b = s[plate]
            s[plate] = b - b * b * b * p[name]

    return add(model, "field", "field_saturation", free([name], 0.5, "1", "compression at the peak"), step)
