"""Ends of a Halbach array: the finite field, sensors chosen anew, travel over many periods.

Independent facts: cuboid magnets of magpylib; the error of 10 mm period of Maguire's thesis (UBC 2015).
"""

import re
import sys
from functools import partial
from pathlib import Path

import halbach_plant as plant
import numpy as np
import pytest
from firmware import passes, written
from twins import altered, example_log, swept

import hallsym
from hallsym import Log, Noise
from hallsym.families.halbach import finite
from hallsym.families.halbach.effects import ends, magnets
from hallsym.families.halbach.finite import strength
from hallsym.families.halbach.layout import Array, Sensor, arrays, columns
from hallsym.families.halbach.models import halbach
from hallsym.log import Meta
from hallsym.uncertainty import errors_along

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import bench_halbach

from hallsym.families.halbach import PLANAR, half_turned
from hallsym.families.halbach.effects import mechanics, transducer
from hallsym.families.halbach.planar import halbach_planar

NINE = columns([(j - 4) * 0.01 for j in range(9)])


def read(model, values, x, z):
    """Readings (K, n) at arrays of x and z, by values of named parameters."""
    return model.readings(model.vector(values), [x, z])


def test_a_finite_array_is_that_of_cuboids():
    """The field of wide cuboid magnets (magpylib), under the array, at its ends and beyond: to 1e-5."""
    pytest.importorskip("magpylib")
    wide = ends.array_edges(halbach(columns((0.0,), length_m=0.12) + columns((0.01,))[:1]))
    x = np.linspace(-0.09, 0.09, 13)
    points = np.column_stack([-x, 0 * x, 0 * x - 5e-3])
    true = plant.field(plant.magnets(0, np.zeros(2), 0.12, 0.5), points)[:, 2]
    ours = read(wide, {"a1": 1.0, "a5": FIFTH, "edges": 1.0}, x, np.full(13, 5e-3))[0]
    scale = true @ ours / (ours @ ours)
    assert np.abs(true / scale - ours).max() < 2e-4  # of which the ninth harmonic has 7e-5


@pytest.mark.parametrize("count", [3, 4, 6, 8])
def test_an_endless_array_has_the_harmonics_of_its_magnets_per_period(count):
    """In the middle of a long and wide array of cuboids: 1, 1 + n, 1 + 2 n, ... of n magnets a period."""
    array = Array("X", 0.03, length_m=1.2, width_m=1.2, magnets_per_period=count, middle_magnet=1)
    u, gap = np.linspace(-0.015, 0.015, 13), np.full(13, 3e-3)
    field = [
        f(array, u, *((0 * u, gap) if f is finite.cuboids else (gap,)))
        for f in (finite.cuboids, finite.harmonics)
    ]
    assert np.abs(np.subtract(*field)).max() < 1e-4


FIFTH = strength(columns((0.0,))[-1], 5)
"""Fifth harmonic of square magnets over the first, at the level."""


@pytest.mark.parametrize("middle", range(8))
def test_an_array_of_stated_width_is_that_of_cuboids(middle):
    """Narrow arrays with every magnet in the middle (magpylib), and what the model has of them in its box."""
    pytest.importorskip("magpylib")
    array = Array("X", 0.03, length_m=0.15, width_m=0.06, ends=True, middle_magnet=middle)
    rng, size = np.random.default_rng(middle), plant.BR * finite.filled(array, 1) * np.exp(-np.pi / 3)
    x, z = rng.uniform(-0.015, 0.015, 40), rng.uniform(3e-3, 7e-3, 40)
    parts = plant.magnets(0, np.zeros(2), 0.15, 0.06, middle)
    at = np.column_stack([0.01 - x, np.full(40, 0.01), -z])
    true = plant.field(parts, at) / size
    up, along = finite.cuboids(array, at[:, 0], at[:, 1], z)
    assert np.abs(true[:, [2, 0]].T - [up, along]).max() < 1e-12
    seen = Sensor("col_0_v", ((0.01, 0.01),))
    other = Sensor("col_1_v", ((0.0, 0.01),))
    turns = np.exp(1j * middle * np.pi / 4 * np.array([1, 5]))
    own = {f"{n}{h}": float(strength(array, h) * part(t)) for h, t in zip((1, 5), turns, strict=True)
           for n, part in (("a", np.real), ("b", np.imag))}  # fmt: skip
    off = true[:, 2] - read(halbach((seen, other, array)), own, x, z)[0]
    plain = true[:, 2] - read(halbach((seen, other, array.stated)), own, x, z)[0]
    assert abs(off.mean()) < 2e-5  # of which no offset is made
    assert off.std() < 1e-4  # without the ninth harmonic 1.4e-4 to 2.5e-4
    assert abs(off.mean()) < 0.1 * abs(plain).mean()


def finite_machine(stated, middle=3, width=0.06):
    """A log of five sensors under .18 m of cuboids, the reference's zero 1.3 mm off, and their offsets."""
    rng, count, places = np.random.default_rng(5), 1500, (np.arange(5) - 2) * 0.01
    t, off = np.linspace(0, 2 * np.pi, count), 0.01 * np.random.default_rng(6).standard_normal(5)
    x, z = 0.016 * np.sin(17 * t), 5e-3 + 8e-4 * np.sin(41 * t)
    parts = plant.magnets(0, np.zeros(2), 0.18, width, middle)
    at = [np.column_stack([p - x - 1.3e-3, 0 * x, -z]) for p in places]
    v = np.array([4 * plant.field(parts, point)[:, 2] for point in at]) + off[:, None]
    names = [f"col_{k}_v" for k in range(5)]
    data = dict(zip(names, v + 1e-3 * rng.standard_normal(v.shape), strict=True))
    data |= {"x_ref_m": x, "z_ref_m": z, "run": np.arange(count) // 300, "t_s": 0.01 * np.arange(count)}
    probes = [{"channel": n, "position_m": [float(p)]} for n, p in zip(names, places, strict=True)]
    array = {"name": "X", "wavelength_m": 0.03, "length_m": 0.18} | ({"width_m": width} if stated else {})
    noise = dict.fromkeys(names, 1e-3) | {"x_ref_m": 1e-7, "z_ref_m": 1e-7}
    meta = Meta(probes=probes, raw={"arrays": [array]})
    return Log.from_arrays(data, Noise.given(noise, tuple(data)), meta), off


@pytest.mark.slow
def test_offsets_beside_the_ends_of_a_stated_array_are_within_their_uncertainties(tmp_path):
    """Without its width they are many sigma off, and a note says so; C of the fit says what ends leave."""
    pytest.importorskip("magpylib")
    far, effects = {}, ["gain_mismatch", "offset_error"]
    for stated in (False, True):
        log, off = finite_machine(stated)
        fit = hallsym.fit(log, "halbach", effects=effects, solver="direct", loss="none")
        own = [fit.model.names.index(f"offset_error_{k}") for k in range(5)]
        far[stated] = np.abs((fit.values[own] - off) / fit.std[own]).max()
        assert any("The ends of array" in note for note in fit.notes) == (not stated)
    assert far[False] > 5
    assert far[True] < 3.3
    assert fit.model.layout[-1].middle_magnet == 3
    fit.save(tmp_path / "calib.json")
    again = hallsym.load_fit(tmp_path / "calib.json")
    assert again.model.layout == fit.model.layout
    code = hallsym.generate(again)
    assert any("What ends and sides of the array do leaves at most" in said for said in code.decoupler.said)
    passes(written(code, tmp_path / "fw"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "make", "seed"),
    [
        ("halbach", bench_halbach.two, 100),
        ("halbach_planar", partial(bench_halbach.planar, places_m=5e-5), 103),
    ],
)
def test_gains_offsets_and_places_of_a_drawn_machine_are_recovered(model, make, seed):
    pytest.importorskip("magpylib")
    off = np.concatenate(list(bench_halbach.deviations(model, make, seed)[0].values()))
    assert np.abs(off).max() < 4.0
    assert 0.6 < np.sqrt(np.mean(off**2)) < 1.6  # nor are the uncertainties larger than they need be


@pytest.mark.slow
def test_a_model_that_knows_its_ends_is_made_from_the_log_without_its_mistakes():
    """The travel over which it knows them is that of the corrected log, whatever was logged."""
    pytest.importorskip("magpylib")
    log, _ = finite_machine(True)
    log = altered(log, z_ref_m=1000 * log.array("z_ref_m"))
    options = {"effects": ["gain_mismatch", "offset_error"], "solver": "direct", "loss": "none"}
    result = hallsym.fit(log, "halbach", **options, corrections=["scale z_ref_m mm"], accept=["all"])
    assert not any("beyond the travel" in note for note in result.notes)


def travelling(count=24, stroke=0.1):
    """A log of an array of four periods over a board of eight, and the model that made it."""
    places = [(j - (count - 1) / 2) * 0.01 for j in range(count)]
    wide = ends.array_edges(halbach(columns(places, length_m=0.12)))
    values = {"a1": 0.62, "b1": 0.11, "a5": -6e-4, "b5": -8e-4, "edges": 1.0}
    return wide, values, swept(wide, values, [(1.0, stroke, f, 1e-3, 2.3 * f, 5e-3) for f in (1.1, 1.4)])


@pytest.mark.slow
def test_a_log_over_many_periods_is_fitted_and_decoded_without_a_reference():
    wide, values, log = travelling()
    bare = halbach(wide.layout)
    fit = hallsym.fit(log, bare, effects=["array_edges"], solver="direct")
    assert fit.value("edges") == pytest.approx(1.0, abs=2e-3)
    rmse = fit.errors.rows()["fitted"]["rmse"]
    assert all(rmse[c] == pytest.approx(floor, rel=0.15) for c, floor in fit.noise_floor.items())
    assert not fit.model.period  # x is known over all periods
    v = np.array([log.array(c) for c in bare.channels])
    found = fit.model.decode(fit.model.vector(values), [], v, [], np.full(len(v), 1e6))
    assert np.abs(found[0] - log.array("x_ref_m")).max() < 3e-5
    claims = {claim.name: claim.text for claim in hallsym.fit(log, bare, solver="direct").claims}
    assert re.search(r"outside the field in \d+ % of the samples", claims["beyond"])


@pytest.mark.slow
def test_the_decoded_place_has_no_step_as_sensors_come_and_go():
    wide, values, _ = travelling()
    x = np.arange(-0.105, 0.105, 1e-4)
    v = read(wide, values, x, np.full(len(x), 5e-3))
    found = wide.decode(wide.vector(values), [], v, [], np.ones(len(v)))
    assert np.abs(found[0] - x).max() < 1e-8
    away = ends.seen(arrays(wide.layout)["X"], 0.061)
    assert float(away) == 0.0


def test_a_board_shorter_than_the_array_stays_within_a_wavelength():
    assert ends.array_edges(halbach(NINE)).period == halbach(NINE).period


def test_what_the_ends_take_of_the_field_is_noted_where_it_counts():
    """Under the middle of .24 m of magnets it counts, under that of 2 m it does not."""
    rng = np.random.default_rng(1)
    x, z = rng.uniform(-0.015, 0.015, 500), rng.uniform(4e-3, 6e-3, 500)
    log = Log.from_arrays({"x_ref_m": x, "z_ref_m": z})

    def share(length_m):
        model = halbach(columns((-0.01, 0.0, 0.01), length_m=length_m))
        said = [n for n in model.inspect(model, log).notes if "The ends of array X" in n]
        return float(re.search(r"up to ([\d.e-]+) % of the field", said[0])[1]) / 100 if said else 0.0

    assert 2e-4 < share(0.24) < 3e-3
    assert share(0.24) > 2 * share(0.48) > 0
    assert share(2.0) == 0.0
    ended = ends.array_edges(halbach(columns((-0.01, 0.0, 0.01), length_m=0.24)))
    assert not ended.inspect(ended, log).notes


def swept_at(wide, values, *gaps):
    """Sweeps of x of three sums at gaps that stand still."""
    moves = [(2.0, 0.03, f, 0.0, 1.0, gaps[k % len(gaps)]) for k, f in enumerate((1.0, 1.3, 0.9, 0.7))]
    return swept(wide, {"a1": 0.62} | values, moves)


@pytest.mark.slow
def test_steps_where_sensors_change_are_no_harmonic():
    """Sums as long as the array see its ends in turn: readings tell what decoded errors alone do not."""
    sums = [
        Sensor(f"col_{j}_v", tuple(((j - 1) * 0.01 + i * 0.03, 0.0) for i in (-0.5, 0.5))) for j in range(3)
    ]
    model = halbach((*sums, *columns((0.0,), length_m=0.06)[-1:]))
    wide = ends.array_edges(model, reads="nearest")
    error = errors_along(wide, {"edges": 1.0}, plain=model, decoder="closed-form")
    assert error.waves == (3, 3)
    assert error.peak.min() > 1e-4
    found = hallsym.diagnose(swept_at(wide, {"edges": 1.0}, 4.2e-3), model, holdout=[1])
    assert found.ranked == ("array_edges",)


@pytest.mark.parametrize(("unit", "by"), [("mm", 1e3), ("um", 1e6)])
def test_gaps_in_another_unit_are_named(unit, by):
    """Ends are stated, and the field at the logged gaps is beyond numbers: the fit names the unit of z."""
    layout = columns([-0.01, 0.0, 0.01], length_m=0.15, width_m=0.06, ends=True)
    rng = np.random.default_rng(1)
    t = np.linspace(0, 1, 200)
    x, z = 0.02 * np.sin(9 * t), 6e-3 + 1e-3 * np.cos(7 * t)
    v = read(halbach(layout), {"a1": 1.0}, x, z) + 1e-3 * rng.standard_normal((3, 200))
    arrays = {"t_s": t, "x_ref_m": x, "z_ref_m": by * z, **{f"col_{k}_v": v[k] for k in range(3)}}
    log = Log.from_arrays(arrays, meta=Meta(base_model="halbach", probes=[part.entry for part in layout]))
    assert hallsym.fit(log, "halbach").claims[0].correction == f"scale z_ref_m {unit}"


# -- Causes that a log cannot tell apart come as a group, with the recording that separates them ------------


LC_M = 0.03 / 2 / np.pi


HARMONIC, FIELD_ENDS = (magnets.forbidden_harmonics, {"a2": 0.013}), (
    lambda model: ends.array_edges(model, reads="unknown"), {"ends_cos": 0.011, "ends_sin": 0.003}
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "gaps", "alike", "words"),
    [
        (HARMONIC, (4.2e-3,), {"forbidden_harmonics", "array_edges"}, ("another gap", "a longer array")),
        (HARMONIC, (4.2e-3, 5.2e-3), {"forbidden_harmonics"}, ()),
        (FIELD_ENDS, (4.2e-3, 5.2e-3), {"array_edges"}, ()),
        # 1 rad of tilt is lc of place; at gaps where the fifth harmonic has faded nothing tells them apart
        ((mechanics.sensor_tilt, {"tiltx_0": 12e-3, "tiltx_2": -9e-3}), (6.2e-3, 7.2e-3),
         {"sensor_tilt", "sensor_position_error"}, ("smaller gap",)),
        ((lambda model: magnets.lost_magnet(model, magnet=1), {"lost_1": 1.0}), (4.2e-3, 5.2e-3),
         {"lost_magnet", "remanence_spread"}, ("",)),
    ],
)  # fmt: skip
def test_causes_that_look_alike_come_as_a_group_with_the_recording_that_separates_them(
    cause, gaps, alike, words
):
    (widened, values), model = cause, halbach()
    found = hallsym.diagnose(swept_at(widened(model), values, *gaps), model, holdout=[1])
    assert found.verdict == "explained"
    assert [set(group) for group in found.groups] == ([alike] if words else [])
    assert found.ranked[0] in alike if words else found.ranked == (*alike,)
    assert all(word in found.separate_by[0].recording for word in words)
    if "lost_1" in values:
        assert found.effects[0].parameters["lost_1"].value == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
def test_the_height_of_an_array_and_the_gain_of_its_patch():
    """A common gain of the sensors under an array is exp(height / lc)."""
    model = halbach_planar()
    wide = mechanics.array_geometry_error(model, array="X1")
    found = hallsym.diagnose(example_log(wide, {"dz_X1": 6e-5}, step_s=2e-2), model, holdout=[1])
    assert found.verdict == "explained"
    assert {"array_geometry_error", "gain_mismatch"} in [set(group) for group in found.groups]
    assert "turned half round" in found.separate_by[0].recording


def test_the_height_of_an_array_is_a_gain_of_its_patch_until_the_mover_is_turned():
    """Of a level mover whose field has one harmonic; a turned mover brings another array over the patch."""
    height = 6e-5
    forms = {
        mechanics.array_geometry_error(halbach_planar(), array="X1", only="height"): {"dz_X1": height},
        transducer.gain_mismatch(halbach_planar(), of="X1"): {"gain_X1": np.expm1(-height / LC_M)},
    }
    pose = np.array([[3e-3, -1e-3, z, 0, 0, 4e-3] for z in (4e-3, 5e-3, 8e-3)]).T

    def apart(*models):
        read = [
            np.array(m.reading(m.vector({**PLANAR.example.values, "a5": 0.0, **values}), [], pose, []))
            for m, values in zip(models, forms.values(), strict=True)
        ]
        return np.abs(read[0] - read[1]).max() / np.abs(read[0]).max()

    assert apart(*forms) < 1e-12
    assert apart(*map(half_turned, forms)) > 0.5 * height / LC_M
