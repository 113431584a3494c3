"""Waves of finite length that sensors are passed by: where each sensor is, and what it reads under the wave.

All from the readings of the model itself."""

from math import pi

import numpy as np

from hallsym.codegen.lowering.phasors import WIDE, Sample, Window
from hallsym.errors import InputError

STEPS = 16
"""Samples per wavelength of what is seen as the wave passes a sensor."""
BEYOND = 0.02
"""Share of the largest energy that a sensor may see where the wave has passed."""
FROM_END = 0.75
"""Wavelengths from the ends of the wave from which on what a sensor reads is fitted."""
PLACES = 96
"""Places of a sensor under the wave that its reading is fitted to."""


class NeverEnds(InputError):
    """No end of the array lies in the search range."""


def passed(sample: Sample, axis: int, channels: list[int], half: np.ndarray) -> Window:
    """Return what channels read under the wave that passes them, seen beyond a box of `half`.

    What is seen of the pass depends little on the wavelength, which is found twice.
    """
    rough = sample.lc(axis)
    reach = 4 * half[axis] + 8 * pi * rough + WIDE
    for _ in range(2):
        place, length = _pass(sample, axis, channels, reach, 2 * pi * rough)
        under = max(length / 2 - FROM_END * 2 * pi * rough, pi * rough)
        window = Window(sample, axis, channels, np.linspace(-under, under, PLACES), place, rough, length)
        rough = window.lc
    return window


def _pass(
    sample: Sample, axis: int, channels: list[int], reach: float, wavelength: float
) -> tuple[np.ndarray, float]:
    """Return where the middle of the wave is over each channel (n,), from the middle of the box, and its
    length; it must end there."""
    step = wavelength / STEPS
    count = int(reach / step)
    x = step * np.arange(-count, count + 1)
    seen = sample.readings(axis, x, np.full(len(x), sample.middle))[channels]
    field = (seen - seen[:, [0, -1]].mean(axis=1, keepdims=True)) ** 2
    pair = STEPS // 8  # an eighth of a wavelength to both sides: squares of a cosine and a sine
    energy = np.zeros_like(field)
    energy[:, pair:-pair] = field[:, : -2 * pair] + field[:, 2 * pair :]
    total = energy.sum(axis=1)
    place = (energy * x).sum(axis=1) / total
    level = np.array([e[np.abs(x - at) < wavelength].mean() for e, at in zip(energy, place, strict=True)])
    ends = energy[:, [pair, -pair - 1]].max(axis=1)
    if not (np.isfinite(place).all() and (ends < BEYOND * level).all()):
        raise NeverEnds(
            "C of decaying waves is generated for one coordinate that repeats and one height, or for an "
            f"array shorter than the board; what {sample.model.name} reads does not end where the array "
            "has passed."
        )
    return place, float(np.median(total * step / level))
