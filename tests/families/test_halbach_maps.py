"""Planes measured in a magnet of 52.52 mm, nominally 52.5 mm, and a field made up like it.

The laboratory states its probe's cross-axis terms: raw and corrected readings of a plane differ by them.
"""

import numpy as np
import pytest
from beside import REAL, needs
from halbach_plant import BR, field, magnets, readings
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

import hallsym
from hallsym.families.halbach.effects.magnets import magnet_map
from hallsym.families.halbach.layout import Array, Sensor, arrays, columns, sensors
from hallsym.families.halbach.models import halbach
from hallsym.families.halbach.planar import halbach_planar, pinwheel
from hallsym.log import Log, Meta, Noise

MAPS = REAL / "halbach-fieldmaps"
HERE = needs(MAPS)
NOMINAL_M, COUNT, STROKE_M = 0.0525, 6, 0.18
PERIOD_M = 0.0525258
"""Of By on the axis: one sine fitted over the inner 500 mm leaves least."""


def measured(phase, which):
    """x [mm] -> place along the period [m] and field [T] of a measured plane."""
    d = np.genfromtxt(MAPS / f"delta_sabia_phase{phase}_{which}_plane.csv", delimiter=",", names=True)
    rows = {x: d[d["x_mm"] == x] for x in np.unique(d["x_mm"])}
    return {x: (1e-3 * r["z_mm"], {c: r[f"b{c}_t"] for c in "xyz"}) for x, r in rows.items()}


def made_up(which):
    """A circular field that grows off the axis, and raw readings of a probe tilted by 11.4 mrad."""
    z, k = np.arange(-0.32, 0.32, 5e-4), 2 * np.pi / PERIOD_M
    rng = np.random.default_rng(0)
    planes = {}
    for x in range(-5, 6):
        by = 0.87 * np.cosh(0.114 * x) * np.cos(k * z) + 1e-4 * rng.standard_normal(len(z))
        bx = -0.86 * np.sin(k * z) - (0.0114 * by if which == "raw" else 0.0)
        planes[float(x)] = z, {"x": bx, "y": by}
    return planes


def read(lines, gaps, period_m=NOMINAL_M, pitch_m=NOMINAL_M / 3, stroke_m=STROKE_M, length_m=0.64):
    """The log of columns drawn along lines, four runs or one per gap; `lines`: of each column at each gap."""
    count = len(lines[0])
    places = [(k - (count - 1) / 2) * pitch_m for k in range(count)]
    model = halbach(columns(places, period_m, length_m=length_m))
    x = np.arange(-stroke_m, stroke_m, 0.9731e-3)  # no part of a period
    parts = []
    for gap, at in zip(gaps, lines, strict=True):
        for xs in [x] if len(gaps) > 1 else [x[first::4] for first in range(4)]:
            run = {"run": np.full(len(xs), len(parts)), "x_ref_m": xs, "z_ref_m": np.full(len(xs), gap)}
            run |= {f"col_{k}_v": np.interp(p - xs, *at[k]) for k, p in enumerate(places)}
            parts.append(run)
    data = {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}
    data["t_s"] = 0.01 * np.arange(len(data["run"])) + data["run"]
    noise = dict.fromkeys(model.channels, 1e-4) | {"x_ref_m": 1e-6, "z_ref_m": 1e-6}
    return model, Log.from_arrays(data, Noise.given(noise, tuple(data)))


def along(plane, axis, x=0.0):
    """Every column reads the same line."""
    place, field = plane[x]
    return [[(place, field[axis])] * COUNT]


def off_by(fit, name):
    """What every other column's parameter is beyond the others' mean."""
    v = np.array([fit.value(f"{name}_{k}") for k in range(COUNT)])
    return v[1::2].mean() - v[::2].mean()


def check_the_period(plane):
    """Both names give the same period: of this line alone the reference's scale may be off as well."""
    model, log = read(along(plane, "y"), [5e-3])
    for effect, name in (("wavelength_error", "longer"), ("reference_scale_error", "scale_x")):
        fit = hallsym.fit(log, model, effects=[effect], solver="direct", loss="none", accept=["all"])
        assert NOMINAL_M * (1 + fit.value(name)) == pytest.approx(PERIOD_M, abs=5e-6)


def check_the_tilt(raw, corrected, x=-4.0):
    """Columns that read raw values are tilted against those that read corrected ones, or are at other places.

    Cross-axis term .0114 of By beside Bx of .82 times By: 13.9 mrad, lc times that in place.
    """
    share = np.std(corrected[x][1]["y"]) / np.std(corrected[x][1]["x"])
    line = raw[x][0]
    each = [(line, (raw if k % 2 else corrected)[x][1]["x"]) for k in range(COUNT)]
    model, log = read([each], [5e-3])
    for effect, name, unit in (("tilt", "tiltx", 1.0), ("position_error", "dx", PERIOD_M / 2 / np.pi)):
        effects = ["wavelength_error", f"sensor_{effect}"]
        fit = hallsym.fit(log, model, effects=effects, solver="direct", loss="none", accept=["all"])
        assert off_by(fit, name) == pytest.approx(0.0114 * share * unit, rel=0.05)


def off_the_axis(plane):
    """Runs at six distances from the axis, in no order: an array fades as exp, this field grows as cosh."""
    xs = (0, 3, 1, 5, 2, 4)
    return read([along(plane, "y", float(x))[0] for x in xs], [8e-3 - 1e-3 * x for x in xs])


def check_the_growth(plane):
    """The decay of an array leaves more than a millimetre in the gap, whatever its amplitude."""
    model, log = off_the_axis(plane)
    fit = hallsym.fit(log, model, effects=["wavelength_error"], solver="direct", loss="none", accept=["all"])
    assert fit.errors.rows()["fitted"]["rmse"]["z_m"] > 1e-3


@pytest.mark.parametrize("real", [False, pytest.param(True, marks=[HERE, pytest.mark.slow])])
@pytest.mark.parametrize(
    ("check", "plane", "kinds"),
    [
        (check_the_period, "02", ("raw",)),
        pytest.param(check_the_tilt, "04", ("raw", "corrected"), marks=pytest.mark.slow),
        (check_the_growth, "02", ("raw",)),
    ],
)
def test_a_plane(check, plane, kinds, real):
    check(*(measured(plane, kind) if real else made_up(kind) for kind in kinds))


@HERE
@pytest.mark.parametrize(("count", "pitch_m"), [(3, 0.022 / 3), (9, 0.022 / 3), (8, 0.004)])
def test_an_array_of_any_pitch_reads_a_measured_line(count, pitch_m):
    """27 periods of an undulator's magnet: x within 20 um rms, and its real period of 21.9986 mm."""
    line = np.genfromtxt(MAPS / "carnauba_phase0mm_line.csv", delimiter=",", names=True)
    each = [(1e-3 * line["z_mm"], line["by_t"])] * count
    model, log = read([each], [5e-3], 0.022, pitch_m, 0.3, 0.6)
    fit = hallsym.fit(log, model, effects=["wavelength_error"], solver="direct", loss="none", accept=["all"])
    assert fit.errors.rows()["fitted"]["rmse"]["x_m"] < 20e-6
    assert 22 * (1 + fit.value("longer")) == pytest.approx(21.9986, abs=1e-3)


@pytest.mark.slow
def test_places_on_a_grid_are_not_coarse_where_a_field_is_no_array_s():
    """A larger noise of the reference would take up any gap; what is left shows that it is no rounding."""
    model, log = off_the_axis(made_up("raw"))
    near = np.abs(log.array("x_ref_m")) < 0.1
    few = Log.from_arrays({c: log.array(c)[near] for c in log.columns}, log.noise)
    fit = hallsym.fit(few, model, effects=["wavelength_error"], solver="direct", loss="none")
    assert fit.goodness.sentence
    assert "coarse_steps" not in [claim.name for claim in fit.claims]


@HERE
@pytest.mark.slow
def test_a_measured_field_is_diagnosed_with_its_period():
    """What is left beside the period are magnets that differ: 49 um of gap, 8 um with both."""
    model, log = read(along(measured("02", "raw"), "y"), [5e-3])
    found = hallsym.diagnose(log, model, holdout=[1])
    assert found.ranked[0] in ("wavelength_error", "reference_scale_error")
    assert {"magnetisation_angle_error", "remanence_spread"} & set(found.ranked)
    assert found.gap_after.rmse["x_m"] < found.gap_before.rmse["x_m"] / 4


# -- an array of cuboids whose magnets differ, sampled over several periods ----------------------------------

WAVE_M, GAP_M, READING_V, PLACE_M = 0.03, 5e-3, 1e-4, 2e-7


def scattered(seed, flipped=None):
    """Field [T] along twelve periods: remanence off by 1 %, directions by 10 mrad, one magnet flipped."""
    rng, u = np.random.default_rng(seed), np.arange(-0.13, 0.13, 4e-4)
    parts = []
    for number, (dimension, at, (x, y, z)) in enumerate(magnets(0, (0, 0), 0.36, 0.1)):
        share, turn = (1, 1e-2) + np.array([1e-2, 1e-2]) * rng.standard_normal(2) - (0, 1e-2)
        share *= -1 if number == flipped else 1
        pol = share * np.array([x * np.cos(turn) - z * np.sin(turn), y, x * np.sin(turn) + z * np.cos(turn)])
        parts.append((dimension, at, pol))
    return CubicSpline(u, field(parts, np.column_stack([u, 0 * u, 0 * u - GAP_M]))[:, 2])


def drawn_along(seen, passes, noise, seed=0, count=400):
    """The log of six columns: `passes` over 160 mm, or one in four runs; `noise(rng, shape)` [V]."""
    rng, x, places = np.random.default_rng(seed), np.linspace(-0.08, 0.08, count), (np.arange(6) - 2.5) * 0.01
    runs = [x[:: 1 - 2 * (r % 2)] for r in range(passes)] if passes > 1 else np.split(x, 4)
    at = np.concatenate(runs)
    data = {"run": np.repeat(np.arange(len(runs)), [len(r) for r in runs]), "t_s": 0.01 * np.arange(len(at))}
    data |= {"x_ref_m": at, "z_ref_m": np.full(len(at), GAP_M)}
    data |= {c: v + PLACE_M * rng.standard_normal(len(at)) for c, v in data.items() if c.endswith("_m")}
    readings = seen(places[:, None] - at) + noise(rng, (6, len(at)))
    data |= {f"col_{k}_v": v for k, v in enumerate(readings)}
    sigma = dict.fromkeys(data, READING_V) | dict.fromkeys(("x_ref_m", "z_ref_m"), PLACE_M)
    sigma = {c: v for c, v in sigma.items() if c not in ("run", "t_s")}
    probes = [{"channel": f"col_{k}_v", "position_m": [p]} for k, p in enumerate(places.tolist())]
    about = {"name": "X", "wavelength_m": WAVE_M, "length_m": 0.36}
    return Log.from_arrays(
        data, Noise.given(sigma, tuple(data)), Meta(probes=probes, raw={"arrays": [about]})
    )


def white(rng, shape):
    return READING_V * rng.standard_normal(shape)


def slow(rng, shape):
    """Ten times the stated noise, correlated over five samples."""
    return 10 * np.sqrt(1 - 0.8**2) * lfilter([1], [1, -0.8], white(rng, shape), axis=1)


@pytest.mark.parametrize(
    ("made", "passes", "noise", "is_noise"),
    [
        pytest.param("magnets", 6, white, False, id="magnets differ, places repeat"),
        pytest.param("magnets", 1, white, False, id="magnets differ, every place once"),
        pytest.param("ideal", 6, slow, True, id="correlated noise, places repeat"),
        pytest.param("ideal", 1, slow, False, id="correlated noise, every place once: magnets may make it"),
        pytest.param("ideal", 1, lambda *a: 10 * white(*a), True, id="white noise"),
    ],
)
def test_what_may_repeat_with_the_place_is_no_noise(made, passes, noise, is_noise):
    """Over several periods a residual of other magnets is smooth and never the same: as noise is."""
    seen = scattered(1) if made == "magnets" else lambda u: 0.3 * np.cos(2 * np.pi / WAVE_M * u)
    fit = hallsym.fit(
        drawn_along(seen, passes, noise), "halbach", solver="direct", loss="none", accept=["all"]
    )
    assert fit.goodness.material
    assert (fit.goodness.noise > 0) == is_noise


@pytest.mark.slow
@pytest.mark.parametrize("flipped", [None, 29])
def test_a_map_of_the_magnets_under_the_travel_is_found(flipped):
    """With 1 % and 10 mrad of scatter the holdout error falls to the noise; also with one upside down.

    That one is named and has its own value, and every magnet an uncertainty.
    """
    log = drawn_along(scattered(2, flipped), 6, white)
    found = hallsym.diagnose(log, "halbach", holdout=[4, 5])
    assert (found.verdict, found.ranked[0]) == ("explained", "magnet_map")
    assert found.metric.before > 4 * found.metric.floor
    assert found.metric.after < 1.2 * found.metric.floor
    remark = "" if flipped is None else f"Magnet {flipped - 24} is upside down"
    assert found.effects[0].note.partition(":")[0] == remark
    if flipped is not None:
        fit = hallsym.fit(log, "halbach", effects=["magnet_map"], solver="direct", loss="none")
        assert fit.determined.all()
        assert fit.model.names[np.argmax(np.abs(fit.values))] == f"magnet_{flipped - 24}_remanence"


@pytest.mark.parametrize("planar", [False, True])
def test_a_magnet_of_a_map_is_a_cuboid(planar):
    """The outermost one turned over (magpylib), 10 mm off the middle; of sums across an array to 5e-5."""
    pytest.importorskip("magpylib")
    two = [Sensor(n, ((x, 0.01),)) for n, x in (("a_v", 0.0), ("b_v", 0.01))]
    layout = pinwheel() if planar else (*two, Array("X", 0.03))
    array, seen = arrays(layout)["X1" if planar else "X"], sensors(layout)
    model = magnet_map((halbach_planar if planar else halbach)(layout))
    label = "X1_" if planar else ""
    number = max(int(n.split("_")[-2]) for n in model.names if n.startswith(f"magnet_{label}"))
    amplitude = BR * 4 / np.pi * np.sin(np.pi / 4) * (1 - np.exp(-np.pi / 2)) * np.exp(-np.pi / 3)
    pose = [0.004, 0.003, 6e-3, 0.0, 0.0, 2e-3] if planar else [0.004, 6e-3]
    named = ({"a1": amplitude, f"magnet_{label}{number}_remanence": s} for s in (0.0, -2.0))
    own = [model.readings(model.vector(p), pose).ravel() for p in named]
    parts = magnets(0, array.centre, array.length_m, array.width_m)
    one = [parts[number + len(parts) // 2]]
    full = np.array(pose if planar else [pose[0], 0, pose[1], 0, 0, 0])
    true = [-2 * readings(one, np.array(s.positions), full[None]).mean() for s in seen]
    true = [t if s.array in ("", "X1") else 0.0 for t, s in zip(true, seen, strict=True)]
    assert own[1] - own[0] == pytest.approx(true, abs=(5e-5 if planar else 2e-6) * amplitude)
