"""Gains, offsets and places of drawn machines of cuboid magnets, in standard uncertainties from the truth.

python tests/benchmarks/bench_halbach.py [--seed 2960] [--machines 30] [--planar 0]

Magnets are cuboids of magpylib (`tests/families/halbach_plant.py`); nothing of the model is used. Gains are
those over their mean, which a fit leaves at 1, places those from their mean: a shift of all is one of the
arrays.
"expected" is 1 and the standard deviation of the rms that the stated correlations give.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import hallsym
from hallsym import Log, Noise

sys.path.insert(0, str(Path(__file__).parents[1] / "families"))
import halbach_plant as plant

W = plant.WAVE
REFERENCES = ("x_ref_m", "y_ref_m", "z_ref_m", "rx_ref_rad", "ry_ref_rad", "rz_ref_rad")
CENTRES = {"X1": (-2.5, 3.0), "X2": (2.5, -3.0), "Y1": (3.0, 2.5), "Y2": (-3.0, -2.5)}


def log_of(rng, seen, pose, names, references, channels, arrays):
    """Return the log of a machine whose channels see `seen` (K, n) at 1 V, and what is true of it."""
    runs, sigma = int(rng.integers(3, 7)), float(rng.choice([3e-4, 1e-3, 3e-3]))
    gains, offsets = 0.025 * rng.standard_normal(len(names)), 0.01 * rng.standard_normal(len(names))
    v = seen * (1 + gains[:, None]) + offsets[:, None] + sigma * rng.standard_normal(seen.shape)
    std = {c: 1e-7 if c.endswith("_m") else 1e-6 for c in references}
    refs = {c: p + std[c] * rng.standard_normal(len(p)) for c, p in zip(references, pose, strict=True)}
    count = seen.shape[1]
    data = dict(zip(names, v, strict=True)) | refs
    data |= {"run": np.arange(count) * runs // count, "t_s": 0.01 * np.arange(count)}
    noise = dict.fromkeys(names, sigma) | std
    meta = hallsym.log.Meta(probes=channels, raw={"arrays": arrays})
    log = Log.from_arrays(data, Noise.given(noise, tuple(data)), meta)
    return log, {"gain": (1 + gains) / (1 + gains).mean() - 1, "offset_error": offsets}


def two(seed):
    """One array of 150 to 300 x 40 to 120 mm over 3 to 9 sensors, any magnet in its middle."""
    rng = np.random.default_rng(seed)
    places = (np.arange(n := int(rng.choice([3, 5, 6, 9]))) - (n - 1) / 2) * W / 3
    length, width = max(rng.uniform(0.15, 0.30), 0.09 + 2 * places.max()), rng.uniform(0.04, 0.12)
    parts = plant.magnets(0, np.zeros(2), length, width, int(rng.integers(0, 8)))
    t, shift = np.linspace(0, 2 * np.pi, int(rng.integers(1000, 3000))), rng.uniform(-3e-3, 3e-3)
    x = 0.016 * np.sin(rng.uniform(11, 23) * t)
    z = 5e-3 + rng.uniform(4e-4, 1e-3) * np.sin(rng.uniform(29, 53) * t)
    off = 5e-5 * rng.standard_normal(n)
    at = [np.column_stack([p - x - shift, 0 * x, -z]) for p in places + off]
    names = [f"col_{k}_v" for k in range(n)]
    channels = [{"channel": c, "position_m": [float(p)]} for c, p in zip(names, places, strict=True)]
    array = {"name": "X", "wavelength_m": W, "length_m": length, "width_m": width}
    seen = 4 * np.array([plant.field(parts, p)[:, 2] for p in at])
    log, true = log_of(rng, seen, (x, z), names, ("x_ref_m", "z_ref_m"), channels, [array])
    return log, true | {"dx": off}


def planar(seed, places_m=0.0):
    """Four arrays of 180 x 150 mm over sums of three sensors, or over each of 72, that stand so far off."""
    rng = np.random.default_rng(seed)
    parts, arrays, names, channels, places, off = [], [], [], [], [], ([], [])
    sums, place_rng = bool(seed % 2), np.random.default_rng([seed, 1])
    for name, centre in ((n, W * np.array(c)) for n, c in CENTRES.items()):
        i = "XY".index(name[0])
        parts += plant.magnets(i, centre, 6 * W, 5 * W)
        size = {"length_m": 6 * W, "width_m": 5 * W, "middle_magnet": 0}
        where = {"name": name, "periodic_along": "xy"[i], "centre_m": centre.tolist(), "wavelength_m": W}
        arrays.append(where | size)
        for k in range(6):
            own = [centre + W / 3 * np.roll([k - 2.5, j - 1], i) for j in range(3)]
            for group in [own] if sums else [[p] for p in own]:
                names.append(f"hall_{len(names)}_0_v")
                positions = [p.tolist() for p in group]
                channels.append({"channel": names[-1], "array": name, "positions_m": positions})
                off[i].append(places_m * place_rng.standard_normal())
                places += [p + off[i][-1] * np.eye(2)[i] for p in group]
    t = np.linspace(0, 2 * np.pi, 1200)
    size = np.array([0.015, 0.015, 1.2e-3, 6e-3, 6e-3, 6e-3])
    pose = size * np.sin(rng.uniform(5, 23, 6) * t[:, None] + rng.uniform(0, 6, 6)) + [0, 0, 6e-3, 0, 0, 0]
    seen = 4 * plant.readings(parts, np.array(places), pose).reshape(len(names), -1, len(t)).mean(axis=1)
    log, true = log_of(rng, seen, pose.T, names, REFERENCES, channels, arrays)
    return log, true | ({"dx": np.array(off[0]), "dy": np.array(off[1])} if places_m else {})


def deviations(model, make, seed):
    """Return estimates of a drawn machine less the truth over their standard uncertainty, by effect.

    Beside them the sum of squares of their stated correlations.
    """
    log, true = make(seed)
    effects = ["gain_mismatch", "offset_error"] + ["sensor_position_error"] * ("dx" in true)
    fit = hallsym.fit(log, model, effects=effects, solver="direct", loss="none")
    z, alike = {}, {}
    for name, values in true.items():
        at = [k for k, n in enumerate(fit.model.names) if n.startswith(f"{name}_")]
        own = np.eye(len(at)) - (name[0] == "d") / len(at)
        covariance = own @ fit.covariance[np.ix_(at, at)] @ own
        std = np.sqrt(np.diag(covariance))
        z[name] = own @ (fit.values[at] - values) / std
        alike[name] = np.sum((covariance / np.outer(std, std)) ** 2)
    return z, alike


def main():
    asked = argparse.ArgumentParser(description=__doc__)
    for name, usual in (("seed", 2960), ("machines", 30), ("planar", 0)):
        asked.add_argument(f"--{name}", type=int, default=usual)
    args = asked.parse_args()
    for model, make, many in (("halbach", two, args.machines), ("halbach_planar", planar, args.planar)):
        every, alike = {}, {}
        for seed in range(args.seed, args.seed + many):
            z, own = deviations(model, make, seed)
            for name in z:
                every[name] = np.append(every.get(name, []), z[name])
                alike[name] = alike.get(name, 0.0) + own[name]
            said = ", ".join(f"{n} {np.abs(v).max():.2f}" for n, v in z.items())
            print(f"{model} {seed}: {len(z['gain'])} channels, largest {said}", flush=True)
        for name, v in every.items():
            spread = np.sqrt(2 * alike[name]) / len(v) / 2
            print(f"{model}, {name}: {len(v)}, largest {np.abs(v).max():.2f}, "
                  f"rms {np.sqrt(np.mean(v**2)):.3f} (expected 1 +- {spread:.3f})")  # fmt: skip


if __name__ == "__main__":
    main()
