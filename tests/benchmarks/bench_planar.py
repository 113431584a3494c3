"""Six coordinates decoded on finite arrays of cuboids (magpylib): closed form against all sensors, no noise.

`python tests/benchmarks/bench_planar.py` prints the tables of docs/halbach.md. "Small angles" is the thesis's
8 x 6 least squares without what `begin` takes off: the exact rigid body and the turn of the field vector.
The misfit is what amplitudes alone leave of the readings at the true poses.
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "families"))
import halbach_campaigns as campaigns
from halbach_plant import magnets, readings
from test_halbach_planar import drawn, log_of, plant, rms, single

import hallsym
from hallsym.families.halbach import planar
from hallsym.families.halbach.layout import arrays, sensors
from hallsym.log import near
from hallsym.model import on_arrays

KINDS = {  # name: which coordinates move, gap (from, to), turn (or within), x and y within
    "gap 4.5 mm, level": ((1, 1, 0, 0, 0, 0), (4.5e-3,), 0.01, 0.0125),
    "gap 6.5 mm, level": ((1, 1, 0, 0, 0, 0), (6.5e-3,), 0.01, 0.0125),
    "yaw 10 mrad, 6.5 mm": ((1, 1, 0, 0, 0, 1), (6.5e-3,), 0.01, 0.0125),
    "ry 10 mrad, 6.5 mm": ((1, 1, 0, 0, 1, 0), (6.5e-3,), 0.01, 0.0125),
    "all six, within 3 mrad": ((1, 1, 1, 1, 1, 1), (4.5e-3, 8.5e-3), 0.003, 0.0125),
    "all six, within 6 mrad": ((1, 1, 1, 1, 1, 1), (4.5e-3, 8.5e-3), 0.006, 0.0125),
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


def plants():
    """Models of campaigns, and which arrays the plant has for each sensor (its own, or all): name -> both."""
    four, one = campaigns.four_arrays(), campaigns.one_array()
    return {"one array": (one, False), "four": (four, False), "four, without the other three": (four, True)}


def misfit():
    """Print what amplitudes leave of each plant's readings at the true poses, without and with one offset."""
    for name, (model, alone) in plants().items():
        known, at = arrays(model.layout), campaigns.poses(model, np.random.default_rng(3), POSES)
        v = []
        for s in sensors(model.layout):
            seen = [known[s.array]] if alone else known.values()
            parts = [m for a in seen for m in magnets(a.axis, a.centre, a.length_m, a.width_m)]
            v.append(campaigns.V_PER_T * readings(parts, np.array(s.positions), at).mean(axis=0))
        v = np.concatenate(v)
        for kind, made in (("endless", model), ("array_edges", campaigns.finite(model))):
            read, pose = on_arrays(made.reading), at.T if len(made.pose) == 6 else at.T[[0, 2]]
            zero = dict.fromkeys(made.names, 0.0) | ({"edges": 1.0} if made is not model else {})
            unit = [read(made.vector(zero | {a: 1.0}), [], [*pose], [])[0].ravel() for a in ("a1", "a5")]
            print(name, kind, *(left(unit + more, v) for more in ([], [np.ones(len(v))])), sep=" | ")


def left(columns, v):
    """What least squares leaves of readings: rms, peak and the last coefficient, in uV."""
    matrix = np.array(columns).T
    found = np.linalg.lstsq(matrix, v, rcond=None)[0]
    error = 1e6 * (v - matrix @ found)
    offset = f", offset {1e6 * found[2]:.0f}" if len(found) > 2 else ""
    return f"{np.sqrt(np.mean(error**2)):.0f} rms, {np.abs(error).max():.0f} peak{offset}"


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
    misfit()


if __name__ == "__main__":
    main()
