"""A plant of finite arrays of cuboid magnets (magpylib), which knows none of hallsym's formulas."""

import numpy as np

BR = 1.25
WAVE = 0.03
PITCH, HEIGHT = WAVE / 4, WAVE / 4


def magnets(axis, centre, length, width, middle=0):
    """Cuboids (dimension, position of the middle, polarisation) of one array, its lower face at z = 0.

    Four per period, strong side down. The middle is `middle` half magnets beyond the one that points up; the
    last ones are cut where the array ends.
    """
    out, most = [], round(length / PITCH)
    for i in range(-most, most + 1):
        place = (i - middle / 2) * PITCH
        low, high = np.clip([place - PITCH / 2, place + PITCH / 2], -length / 2, length / 2)
        if high - low < 1e-9:
            continue
        angle = np.pi / 2 - np.pi / 2 * i
        at, dimension, pol = np.zeros(3), np.zeros(3), np.zeros(3)
        at[axis], at[2] = (low + high) / 2, HEIGHT / 2
        at[:2] += centre
        dimension[axis], dimension[1 - axis], dimension[2] = high - low, width, HEIGHT
        pol[axis], pol[2] = BR * np.cos(angle), BR * np.sin(angle)
        out.append((dimension, at, pol))
    return out


def field(parts, points):
    """Field (n, 3) [T] of cuboids at points (n, 3), both in the mover's axes."""
    import magpylib

    total = np.zeros_like(points)
    for dimension, at, pol in parts:
        total += magpylib.magnet.Cuboid(dimension=dimension, polarization=pol, position=at).getB(points)
    return total


def rotation(rx, ry, rz):
    """Rz Ry Rx."""
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(a), np.sin(a)) for a in (rx, ry, rz))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def readings(parts, elements, poses):
    """Field along the board's normal [T], (elements, poses), of poses (n, 6)."""
    out = np.empty((len(elements), len(poses)))
    points, turns = [], []
    for pose in poses:
        turn = rotation(*pose[3:])
        points.append((np.column_stack([elements, np.zeros(len(elements))]) - pose[:3]) @ turn)
        turns.append(turn)
    found = field(parts, np.concatenate(points)).reshape(len(poses), len(elements), 3)
    for n, turn in enumerate(turns):
        out[:, n] = found[n] @ turn[2]
    return out
