"""Six coordinates decoded on finite arrays of cuboids (magpylib): closed form against all sensors, no noise.

`python tests/benchmarks/bench_planar.py` prints the table of docs/theory.md. "Small angles" is the thesis's
8 x 6 least squares without what `begin` takes off: the exact rigid body and the turn of the field vector.
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "families"))
from test_halbach_planar import drawn, log_of, plant, rms, single

import hallsym
from hallsym.families.halbach import planar
from hallsym.log import near
from hallsym.model import on_arrays

KINDS = {  # name: which coordinates move, gap (from, to), turn (or within), x and y within
    "gap 4.5 mm, level": ((1, 1, 0, 0, 0, 0), (4.5e-3,), 0.01, 0.0125),
    "yaw 10 mrad, 6.5 mm": ((1, 1, 0, 0, 0, 1), (6.5e-3,), 0.01, 0.0125),
    "ry 10 mrad, 6.5 mm": ((1, 1, 0, 0, 1, 0), (6.5e-3,), 0.01, 0.0125),
    "all six, within 10 mrad": ((1, 1, 1, 1, 1, 1), (4.5e-3, 8.5e-3), 0.01, 0.0125),
    "all six, within 15 mm, 4 to 10 mm, 10 mrad": ((1, 1, 1, 1, 1, 1), (4e-3, 1e-2), 0.01, 0.015),
}
"""One gap goes with turns that stand still."""
POSES = 120


def poses(kind, rng, count):
    """Poses (count, 6)."""
    moves, gap, turn, stroke = KINDS[kind]
    out = drawn(rng, count, tilt=turn, low=gap[0], high=gap[-1], stroke=stroke) * moves
    if len(gap) == 1:
        out[:, 2] = gap[0]
        out[:, 3:] = turn * np.array(moves[3:])
    return out


def small_angles(v, values, layout):
    """The 8 x 6 least squares alone, in the linear form that is printed."""
    seen, rows = planar.measured(v, values["a1"], layout), []
    lever = np.array([[0, 0, 0, 1, -1, 0]]) / seen[0][0].array.wavenumber
    matrix = planar.least_squares(layout)
    at = matrix[:, [3, 4]].any(axis=1) & (matrix[:, 2] == 0)
    matrix[at] += lever * (matrix[at] != 0)
    first = {}
    for patch, place, height in seen:
        i, wave = patch.array.axis, patch.array.wavelength_m
        place = first[i] + wave * planar._fraction((place - first[i]) / wave) if i in first else place
        first.setdefault(i, place)
        rows += [place, height]
    pose = ca.DM(np.linalg.pinv(matrix)) @ ca.vertcat(*rows)
    return pose - ca.vertcat(values["x0"], values["y0"], 0, values["rx0"], values["ry0"], values["rz0"])


def main():
    """Print rms errors [um, urad] of each kind of motion and each decoder."""
    model, rng = planar.halbach_planar(single()), np.random.default_rng(0)
    train = drawn(rng, 160)
    fit = hallsym.fit(log_of(model, train, plant(model.layout, train)), model, solver="direct", loss="none")
    v = ca.SX.sym("v", len(model.channels))
    named = {n: ca.SX(x) for n, x in zip(model.names, fit.values, strict=True)}
    forms = [
        on_arrays(ca.Function("closed", [v], [ca.densify(form(v, named, model.layout))]))
        for form in (small_angles, planar.begin)
    ]
    whole = on_arrays(model.decoded)
    print({n: float(f"{x:.4g}") for n, x in zip(model.names, fit.values, strict=True)})
    for kind in KINDS:
        at = poses(kind, rng, POSES)
        read = plant(model.layout, at)
        found = [form(read)[0] for form in forms]
        found.append(whole(fit.values, [], read, [], np.ones(len(read)))[0])
        print(
            kind,
            *(" / ".join(f"{e:.2g}" for e in rms(near(model, f, at.T) - at.T)) for f in found),
            sep=" | ",
        )


if __name__ == "__main__":
    main()
