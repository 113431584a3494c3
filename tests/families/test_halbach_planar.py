"""Six coordinates against finite arrays of cuboids (magpylib) and the symmetries of a rigid body."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from halbach_plant import BR, magnets, readings, rotation

import hallsym
from hallsym import InputError, Log, Noise
from hallsym.estimation.decoding import decoding_gain
from hallsym.families.halbach import PLANAR, finite, planar
from hallsym.families.halbach.effects.ends import planar_array_edges
from hallsym.families.halbach.finite import strength
from hallsym.families.halbach.layout import Array, Sensor, arrays, columns, sensors
from hallsym.families.halbach.models import halbach
from hallsym.log import Fault
from hallsym.model import on_arrays
from tests.codegen.boards import row_layout


def single():
    """The thesis's pinwheel with each of its 72 sensors as a channel."""
    layout, made = planar.pinwheel(), []
    for sensor in sensors(layout):
        for place in sensor.positions:
            made.append(Sensor(f"hall_{len(made)}_0_v", (place,), sensor.array))
    return (*made, *arrays(layout).values())


def drawn(rng, count, tilt=0.01, low=4.5e-3, high=8.5e-3, stroke=0.0125):
    """Random poses (count, 6)."""
    out = np.zeros((count, 6))
    out[:, :2] = rng.uniform(-stroke, stroke, (count, 2))
    out[:, 2] = rng.uniform(low, high, count)
    out[:, 3:] = rng.uniform(-tilt, tilt, (count, 3))
    return out


def log_of(model, poses, v, sigma=3e-3):
    data = dict(zip(model.references, poses.T, strict=True)) | dict(zip(model.channels, v, strict=True))
    data |= {"run": np.arange(len(poses)) * 4 // len(poses), "t_s": 0.01 * np.arange(len(poses))}
    noise = dict.fromkeys(model.channels, sigma)
    noise |= {c: 5e-7 if c.endswith("_m") else 3e-6 for c in model.references}
    return Log.from_arrays(data, Noise.given(noise, tuple(data)))


def rms(error):
    """In um and urad."""
    return 1e6 * np.sqrt((error**2).mean(axis=1))


# -- symmetries ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model():
    return planar.halbach_planar()


def test_a_mover_that_goes_on_by_a_period_along_its_own_axes_reads_the_same(model):
    pose = np.array(model.typical[0])
    before = np.array(model.reading(model.nominal, [], pose, [])).ravel()
    for k, coordinate in enumerate(("x_m", "y_m")):
        step = planar.onward(pose[:, None], coordinate, {})[:, 0]
        assert np.allclose(step[:3], rotation(*pose[3:])[:, k])
        after = np.array(model.reading(model.nominal, [], pose + 0.03 * step, [])).ravel()
        assert np.allclose(after, before, atol=1e-12)


def test_a_level_mover_is_the_model_of_x_and_z(model):
    """Sums under one array along x, level: what `halbach` reads, x from its centre."""
    x1 = [s for s in sensors(model.layout) if s.array == "X1"]
    places = [s.middle[0] - arrays(model.layout)["X1"].centre[0] for s in x1]
    other = halbach(columns(places))
    for x, z in ((1e-3, 5e-3), (-7e-3, 6.3e-3)):
        values = {"a1": 0.7, "a5": -3e-3}
        six = np.array(model.reading(model.vector(values), [], [x, 2e-3, z, 0, 0, 0], [])).ravel()
        two = np.array(other.reading(other.vector(values), [], [x, z], [])).ravel()
        assert np.allclose(six[: len(x1)], two, atol=1e-13)


def test_layouts_that_do_not_tell_six_coordinates_are_refused():
    layout = planar.pinwheel()
    kept = [s for s in sensors(layout) if s.array != "Y2"]
    few = [s for s in sensors(layout) if s.array[0] == "X"]
    few = (*few, *(a for a in arrays(layout).values() if a.along == "x"))
    with pytest.raises(InputError, match="2 arrays tell 4 of six coordinates"):
        planar.halbach_planar(few)
    with pytest.raises(InputError, match="must name its array"):
        planar.halbach_planar((Sensor("hall_0_0_v", ((0.0, 0.0),)), *arrays(layout).values()))
    with pytest.raises(InputError, match="seen by 0 sensors"):
        planar.halbach_planar((*kept, *arrays(layout).values()))
    long = (*sensors(layout), *(Array(a.name, 0.03 + 1e-3 * (n == "X1"), a.along, a.centre)
                                for n, a in arrays(layout).items()))  # fmt: skip
    with pytest.raises(InputError, match="must have one wavelength"):
        planar.halbach_planar(long)


def test_sums_whose_pitch_does_not_cancel_the_crossing_array_are_refused():
    layout = planar.pinwheel()
    first, *others = sensors(layout)
    wide = Sensor(first.channel, tuple((x, 1.2 * y) for x, y in first.positions), first.array)
    with pytest.raises(InputError, match=r"The 3 sensors of channel x1_col_0_v leave \d+ % of the field"):
        planar.halbach_planar((wide, *others, *arrays(layout).values()))


def recorded(model, stroke=0.0125, change=None):
    """A log of the model at its nominal values; `change(data)` spoils it."""
    turns = np.outer(np.linspace(0, 1, 1200), 2 * np.pi * np.array([3, 7, 5, 4, 6, 8]))
    poses = np.sin(turns) * [stroke, stroke, 2e-3, 0.01, 0.01, 0.01] + [0, 0, 6.5e-3, 0, 0, 0]
    v = model.readings(model.nominal, poses.T)
    log = log_of(model, poses, v, 1e-3)
    if change is None:
        return log
    data = {c: log.array(c).copy() for c in (*model.references, *model.channels, "t_s", "run")}
    change(data)
    return Log.from_arrays(data, log.noise)


def spoiled(column, change):
    def apply(data):
        data[column] = change(data[column])

    return apply


@pytest.mark.parametrize(
    ("made", "name", "says"),
    [
        ({"stroke": 0.003}, "short_travel", "covers 6 mm, 0.20 of a wavelength"),
        ({"change": spoiled("x_ref_m", lambda x: x + 0.2)}, "beyond", "goes .* mm beyond sensor x1_col_0_v"),
    ],
)
def test_a_log_that_no_mover_can_have_made_is_claimed_in_one_sentence(model, made, name, says):
    (claim,) = [n for n in model.inspect(model, recorded(model, **made)).notes if isinstance(n, Fault)]
    assert claim.name == name
    assert re.search(says, claim)
    assert "\n" not in claim
    assert len(claim) <= 300


@pytest.mark.slow
def test_a_clipped_sensor_of_a_mover_is_noticed(model):
    """Without the search for its name, which takes a minute of a mover."""
    log = recorded(model, change=spoiled("x1_col_1_v", lambda v: np.clip(v, -0.2, 0.2)))
    amiss = hallsym.fit(log, model, solver="direct", accept=["all"]).goodness
    assert "x1_col_1_v" in amiss.sentence


@pytest.mark.slow
def test_rows_longer_than_the_arrays_are_taken_with_their_ends_and_odd_without():
    model = planar.halbach_planar(row_layout())
    ended = planar_array_edges(model)
    turns = np.linspace(0, 1, 400)[:, None] * 2 * np.pi * [3, 4, 5, 7, 6, 5]
    poses = np.sin(turns) * [0.03, 0.03, 1.5e-3, 5e-3, 5e-3, 5e-3] + [0, 0, 5.5e-3, 0, 0, 0]
    p = ended.vector({"a1": 0.62, "a5": -6e-4, "edges": 1.0})
    v = ended.readings(p, poses.T)
    log = log_of(ended, poses, v, 1e-3)
    planar.inspect(ended, log)
    assert re.search(r"goes .* mm beyond sensor", planar.inspect(model, log).notes[0])
    far = log_of(ended, poses + np.array([0.06, 0, 0, 0, 0, 0]), v, 1e-3)
    few = "has 1 of its 6 sensors under it, where phase and height need 2"
    assert few in planar.inspect(ended, far).notes[0]


def test_a_travel_within_one_wavelength_is_noted(model):
    assert "stays within one wavelength" in model.inspect(model, recorded(model)).notes[0]


def test_a_layout_is_read_from_meta_and_saved(model):
    from hallsym.families import build
    from hallsym.log import Meta

    entries = [dict(part.entry) for part in model.layout]
    raw = {"channels": [e for e in entries if "channel" in e], "arrays": [e for e in entries if "name" in e]}
    assert build("planar_h5", meta=Meta(raw=raw)).layout == model.layout
    assert build("halbach_planar", meta=Meta(probes=entries)).layout == model.layout
    assert PLANAR.reads((*model.channels, *model.references))


@pytest.mark.parametrize(("moves", "most"), [((1, 1, 1, 0, 0, 1), 1), ((1, 1, 1, 1, 1, 1), 30)])
def test_the_closed_form_knows_products_of_angle_and_travel(moves, most):
    """12 mm at 10 mrad are 120 um: small angles alone leave 40 um rms [um] of yaw, 55 um of all six."""
    model = planar.halbach_planar(single())
    poses = drawn(np.random.default_rng(0), 200) * moves
    v = ca.SX.sym("v", len(model.channels))
    named = {n: ca.SX(x) for n, x in zip(model.names, model.nominal, strict=True)}
    closed = on_arrays(ca.Function("closed", [v], [planar.begin(v, named, model.layout)]))
    read = model.readings(model.nominal, poses.T)
    assert np.all(rms(closed(read)[0] - poses.T)[:3] < most)


# -- finite arrays of cuboids --------------------------------------------------------------------------------


def test_ends_of_the_arrays_of_a_mover_are_those_of_cuboids():
    """One element from the middle of its array to 15 mm beyond its end, level and tilted: to 2e-3 of 1 V."""
    pytest.importorskip("magpylib")
    layout = planar.pinwheel()
    wide = tuple(
        Array(p.name, 0.03, p.along, p.centre, p.length_m, 0.5) if isinstance(p, Array) else p for p in layout
    )
    model = planar_array_edges(planar.halbach_planar(wide))
    array = arrays(wide)["X1"]
    parts = magnets(0, array.centre, array.length_m, array.width_m)
    first = sensors(wide)[0]
    shifts = np.linspace(0.0, 0.105, 8) - (first.middle[0] - array.centre[0])
    for tilt in (0.0, 0.01):
        poses = np.array([[-x, 0, 6e-3 + tilt * array.centre[1], tilt, tilt, 0] for x in shifts])
        true = readings(parts, np.array(first.positions), poses).mean(axis=0)
        values = {"a1": BR * AMPLITUDE, "a5": BR * AMPLITUDE * strength(array, 5), "edges": 1.0}
        found = model.readings(model.vector(values), poses.T)[0]
        assert np.abs(found - true).max() < 2e-3 * BR * AMPLITUDE


def test_a_model_with_ends_is_four_arrays_of_cuboids_over_its_box():
    """Sums of three, tilted: to what the polynomials of ends are asked to leave (rms).

    Without the ninth harmonic, or the field of crossing arrays at each element or across, it is more.
    """
    pytest.importorskip("magpylib")
    rng, box = np.random.default_rng(7), (-0.015, 0.015, -0.015, 0.015, 3.5e-3, 8.5e-3)
    layout = tuple(
        replace(p, ends=True, known_m=box) if isinstance(p, Array) else p for p in planar.pinwheel()
    )
    poses = drawn(rng, 60, tilt=0.015, low=6e-3, high=6.5e-3, stroke=0.0145)
    parts = [m for a in arrays(layout).values() for m in magnets(a.axis, a.centre, a.length_m, a.width_m)]
    elements = np.array([place for s in sensors(layout) for place in s.positions])
    true = readings(parts, elements, poses).reshape(24, 3, -1).mean(axis=1) / (BR * AMPLITUDE)
    model = planar.halbach_planar(layout)
    p = model.vector({"a1": 1.0, "a5": strength(arrays(layout)["X1"], 5)})
    off = model.readings(p, poses.T) - true
    assert np.sqrt(np.mean(off**2)) < finite.AIM_PLANAR


AMPLITUDE = 2 * np.sqrt(2) / np.pi * (1 - np.exp(-np.pi / 2)) * np.exp(-2 * np.pi / 6)
"""Of the first harmonic at a gap of 5 mm, over the remanence."""


@pytest.mark.slow
def test_decoding_within_the_noise_over_the_thesis_box():
    model, rng = planar.halbach_planar(), np.random.default_rng(2)
    poses = drawn(rng, 400, low=4e-3, high=1e-2, stroke=0.015)
    clean = model.readings(model.nominal, poses.T)
    noisy = clean + 1e-3 * rng.standard_normal(clean.shape)
    weight = np.full(len(clean), 1e6)
    found = model.decode(model.nominal, [], noisy, [], weight)
    gain = on_arrays(model.noise_gain_at)(model.nominal, [*poses.T], [], weight)[0]
    std = 1e-3 * np.sqrt((gain.reshape(len(clean), 6, -1) ** 2).sum(axis=0))
    from hallsym.log import near

    error = near(model, found, poses.T) - poses.T
    assert np.all(np.abs(np.mean((error / std) ** 2, axis=1) - 1) < 0.3)


@pytest.mark.slow
def test_the_gain_of_many_readings_in_numbers_is_that_of_the_expression():
    model = planar.halbach_planar()
    p, weight = model.vector({"a1": 0.62, "a5": -0.002, "rx0": 3e-4}), np.linspace(0.5, 2, 24)
    pose = [*np.array(model.typical).T]
    found = decoding_gain(model, p, pose, [], weight)
    expected = on_arrays(model.noise_gain_at)(p, pose, [], weight)[0]
    expected = expected.reshape(24, 6, -1).swapaxes(0, 1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
