"""The arctangent as encoder chips compute it: CORDIC in vectoring mode, without its rounding."""

import numpy as np

from hallsym.errors import InputError


def cordic_angle(y: np.ndarray, x: np.ndarray, steps: int) -> np.ndarray:
    """Return the angle [rad] of (x, y) after `steps` rotations by atan(2^-k), k = 0 .. steps - 1, same shape.

    The vector is turned into the right half plane first. What is left is at most atan(2^-(steps - 1)): for 8
    steps 0.007812 rad, which is 0.4476 deg. Volder, IRE Trans. Electron. Comput. 8 (1959) 330,
    doi:10.1109/TEC.1959.5222693.

    >>> float(np.round(cordic_angle(np.array(1.0), np.array(1.0), 1), 6))
    0.785398
    """
    if steps < 1:
        raise InputError(f"Input steps of cordic_angle must be 1 or more; instead received {steps}.")
    x, y = np.array(x, dtype=float), np.array(y, dtype=float)
    angle = np.where(x < 0, np.where(y >= 0, np.pi, -np.pi), 0.0)
    flip = np.where(x < 0, -1.0, 1.0)
    x, y = x * flip, y * flip
    for k in range(steps):
        turn, size = np.where(y >= 0, 1.0, -1.0), 2.0**-k
        x, y = x + turn * y * size, y - turn * x * size
        angle = angle + turn * np.arctan(size)
    return angle
