"""A Halbach array against Maguire's numbers, superposition of magnets, and recovery of what was simulated.

Independent facts: the thesis (UBC 2015) and its tables in data/maguire2015; the field of single magnetised
rectangles, which must add up to the array's harmonics; symmetry (a shift of all sensors is a shift of x).
"""

from dataclasses import replace
from math import exp, pi, sin

import numpy as np
import pytest
from scipy.signal import lfilter
from test_halbach_ends import read
from twins import altered, example_log

import hallsym
from hallsym import InputError, Log
from hallsym.families import build
from hallsym.families.halbach import FAMILY
from hallsym.families.halbach.effects import field, magnets, mechanics, transducer
from hallsym.families.halbach.finite import strength
from hallsym.families.halbach.layout import arrays, columns
from hallsym.families.halbach.models import halbach
from hallsym.families.published import table as published
from hallsym.inference.profiles import profile
from hallsym.log import Meta
from hallsym.model.model import parameter
from hallsym.uncertainty import errors_along

LC = 0.03 / (2 * pi)
PRINTED = dict(zip(published("numbers")["quantity"], published("numbers")["value"], strict=True))
NINE = columns([(j - 4) * 0.01 for j in range(9)])


# -- numbers of the thesis -----------------------------------------------------------------------------------


def test_figure_2_6():
    """Gains 1/1.1, 1/1.1, 1/.9: x by (2-19), z by (2-20) from the sum of squares, which counts z up."""
    model = transducer.gain_mismatch(halbach())
    gains = {"gain_0": 1 / 1.1 - 1, "gain_1": 1 / 1.1 - 1, "gain_2": 1 / 0.9 - 1}
    found = errors_along(model, gains, decoder="sum-of-squares")
    x, z = found.error[0], -found.error[1]
    assert x.max() == pytest.approx(PRINTED["x error of Fig. 2-6"], abs=1e-7)
    assert x.min() == pytest.approx(-PRINTED["x error of Fig. 2-6"], abs=1e-7)
    assert 1e3 * found.at[x.argmax()] == pytest.approx(6.1, abs=0.05)
    assert (1e3 * found.at[x.argmin()] + 1.1) % 15 == pytest.approx(0, abs=0.05)
    assert found.waves == (2, 2)  # a period of 15 mm
    places = found.at
    assert z.max() == pytest.approx(PRINTED["largest z error of Fig. 2-6"], abs=1e-7)
    assert z.min() == pytest.approx(PRINTED["least z error of Fig. 2-6"], abs=1e-7)
    assert 1e3 * places[z.argmax()] % 15 == pytest.approx(10, abs=0.05)
    assert 1e3 * places[z.argmin()] % 15 == pytest.approx(2.5, abs=0.05)


def test_what_the_thesis_prints_wrong():
    """(2-17) has the slope -1 as printed; the fifth harmonic of square magnets is -.180, printed -.14."""
    x = np.linspace(-5e-3, 5e-3, 11)
    a, b, c = read(halbach(), {}, x, np.full(11, 5e-3))
    across = np.sqrt(2 / 3) * (a - b / 2 - c / 2)
    along = np.sqrt(2 / 3) * np.sqrt(3) / 2 * (b - c)
    right, printed = (LC * np.unwrap(np.arctan2(s * along, across)) for s in (-1, 1))
    assert np.polyfit(x, -right, 1)[0] == pytest.approx(np.polyfit(x, printed, 1)[0])
    assert abs(np.polyfit(x, printed, 1)[0]) == pytest.approx(1)
    assert np.polyfit(x, right, 1)[0] * np.polyfit(x, printed, 1)[0] < 0
    over_remanence = {h: sin(h * pi / 4) / (h * pi / 4) * (1 - exp(-h * pi / 2)) for h in (1, 5)}  # (2-3)
    assert over_remanence == pytest.approx({1: 0.713, 5: -0.180}, abs=1e-3)


def test_temperature_and_decay():
    for kelvin in (10, 50):
        weaker = halbach().vector({"a1": 0.6 * (1 - 0.0012 * kelvin)})
        v = np.array(halbach().reading(weaker, [], [1e-3, 5e-3], [])).ravel()
        pose = np.array(halbach().decoded(halbach().nominal, [], v, [], np.ones(3))).ravel()
        assert pose[1] - 5e-3 == pytest.approx(PRINTED[f"z error for magnets {kelvin} K warmer"], abs=5e-8)
    model = halbach()
    for h, name in ((1, "first"), (5, "fifth")):
        own = {"a1": float(h == 1), "a5": float(h == 5)}
        near, far = read(model, own, np.zeros(2), np.array([5e-3, 5e-3 + LC / 2]))[1]
        assert 1 - far / near == pytest.approx(PRINTED[f"{name} harmonic lost over half lc"], abs=1e-3)


def test_periods_of_the_error_by_cause():
    model = halbach()
    stretch = mechanics.sensor_position_error(model, along="space")
    causes = {
        "second harmonic": (magnets.forbidden_harmonics(model), {"a2": 0.01}),
        "fourth harmonic": (magnets.forbidden_harmonics(model, order=4), {"a4": 0.01}),
        "fifth harmonic": (magnets.forbidden_harmonics(model, order=9), {"a5": -2e-3}),
        "third harmonic": (magnets.forbidden_harmonics(model, order=3), {"a3": 0.01}),
        "ninth harmonic": (magnets.forbidden_harmonics(model, order=9), {"a9": 0.01}),
        "common offset": (field.uniform_stray_field(model), {"uniform_stray_field_all": 5e-3}),
        "one gain": (transducer.gain_mismatch(model), {"gain_0": 0.01}),
        "one position": (mechanics.sensor_position_error(model), {"dx_0": 1e-4}),
        "one height": (stretch, {"dz_0": 1e-4}),
        "one offset": (transducer.offset_error(model), {"offset_error_0": 5e-3}),
    }
    for name, (model, values) in causes.items():
        waves = max(errors_along(model, values, decoder="closed-form").waves)
        assert waves == (round(0.03 / period) if (period := PRINTED[f"error period of {name}"]) else 0), name


# -- independent physics -------------------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [4e-3, 8e-3])
def test_magnets_add_up_to_the_array(gap):
    """All magnets stronger by a share are the array stronger by it: rectangles against harmonics.

    But for those more than a wavelength beyond the outermost sensors, which are not among them: 2 %.
    """
    layout = columns((-0.01, 0.0, 0.01), length_m=1.2)
    model = magnets.remanence_spread(halbach(layout))
    array = {"a1": 0.6, "a5": 0.6 * strength(arrays(layout)["X"], 5)}
    stronger = dict.fromkeys((n for n in model.names if n.startswith("remanence")), 0.3)
    x = np.linspace(-0.01, 0.01, 7)
    plain, more = (read(model, v, x, np.full(7, gap)) for v in (array, array | stronger))
    assert np.abs(more - 1.3 * plain).max() < 0.025 * 0.3 * np.abs(plain).max()


@pytest.mark.parametrize("ends", [False, True])
def test_a_shift_of_all_sensors_is_a_shift_of_x(ends):
    """Of an array with ends it is one of the phase, which says where its magnets are: exactly."""
    x, z = np.linspace(-0.02, 0.02, 9), np.full(9, 4.5e-3)
    about = {"ends": ends, "length_m": 0.15, "width_m": 0.06}
    near, far = (halbach(columns([s + d for s in (-0.01, 0, 0.01)], **about)) for d in (0.0, 2e-3))
    own = {"a1": 0.5, "b1": 0.2, "a5": -1e-3}
    if ends:
        waves = {h: complex(own[f"a{h}"], own.get(f"b{h}", 0.0)) * np.exp(-2e-3j * h / LC) for h in (1, 5)}
        turned = {f"{n}{h}": w for h, u in waves.items() for n, w in (("a", u.real), ("b", u.imag))}
        by = dict.fromkeys(("dx_0", "dx_1", "dx_2"), 2e-3)
        moved = read(mechanics.sensor_position_error(near), turned | by, x, z)
        assert np.allclose(moved, read(near, own, x, z), atol=1e-13)
        return
    assert np.allclose(read(near, own, x, z), read(far, own, x + 2e-3, z), atol=1e-13)
    moved = mechanics.sensor_position_error(near)
    by = {f"dx_{k}": 2e-3 for k in range(3)}
    assert np.allclose(read(moved, own | by, x + 2e-3, z), read(near, own, x, z), atol=1e-13)


def test_sums_over_a_wavelength_cancel_the_crossing_array():
    with pytest.raises(InputError, match="Sums of 3 sensors at a pitch of 8 mm leave"):
        build("halbach", meta=Meta(nominal={"rows_summed": 3, "sensor_pitch_m": 0.008, "columns": 9}))
    build("halbach", meta=Meta(nominal={"rows_summed": 3, "sensor_pitch_m": 0.01, "columns": 9}))
    layout = columns((-0.01, 0.0, 0.01))
    stacked = tuple((-0.01, y) for y in (0.0, 0.008, 0.016))
    with pytest.raises(InputError, match="The 3 sensors of channel col_0_v leave 26 % of the field"):
        halbach((replace(layout[0], positions=stacked), *layout[1:]))


def test_wavelength_is_scale_of_x_and_z_with_the_pitch():
    """A longer wavelength is the same field at coordinates and places that are shorter by its share."""
    longer = magnets.wavelength_error(halbach())
    short = halbach(columns([x / 1.02 for x in (-0.01, 0.0, 0.01)]))
    x, z = np.linspace(-0.02, 0.02, 9), np.full(9, 5.4e-3)
    inner = 5e-3 + (z - 5e-3) / 1.02
    assert np.allclose(read(longer, {"longer": 0.02}, x, z), read(short, {}, x / 1.02, inner), atol=1e-13)


# -- fits ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("gain_mismatch", {"gain_0": 0.012, "gain_4": -0.009}),
        ("offset_error", {"offset_error_2": 4e-3}),
        ("sensor_position_error", {"dx_1": 8e-5, "dx_7": -6e-5}),
        ("forbidden_harmonics", {"a2": 3e-3, "b2": -1e-3}),
        ("wavelength_error", {"longer": 2e-3}),
        ("finite_width", {"fading": 3.0}),
        pytest.param(
            "magnet_map",
            {"magnet_-3_remanence": 0.05, "magnet_2_turn": 0.03, "magnet_4_remanence": -2.0},
            marks=pytest.mark.slow,
        ),
        ("reference_scale_error", {"scale_x": 1e-3, "scale_z": 5e-3}),
    ],
)
def test_a_fit_finds_an_effect_that_was_simulated(effect, values):
    known = {e.name: e for e in FAMILY.effects}
    log = example_log(known[effect](halbach(NINE)), values)
    fit = hallsym.fit(log, halbach(NINE), effects=[effect], solver="direct")
    assert fit.status == "converged"
    for n, v in values.items():
        own = next((g.parameters for g in fit.gauges if n in g.parameters), (n,))
        true = v - (np.mean([values.get(k, 0.0) for k in own]) if fit.gauges else 0.0)
        std = dict(zip(fit.model.names, fit.std, strict=True))[n]
        assert abs(fit.value(n) - true) < 5 * std + 1e-3 * abs(v)
    rmse = fit.errors.rows()["fitted"]["rmse"]
    for c, floor in fit.noise_floor.items():
        assert rmse[c] == pytest.approx(floor, rel=0.15)


@pytest.mark.parametrize("per", ["", ":per=channel"])
def test_a_lag_is_the_readings_through_a_low_pass(per):
    """The same readings filtered at a high rate: 2 % of them are within 5e-6, at 8 Hz and .2 ms."""
    tau, rate, fine = 2e-4, 2 * pi * 8, 40
    late, model = build("halbach", added=(f"first_order_lag{per}",)), build("halbach")
    t = np.linspace(0, 0.5, 2000 * fine + 1)
    x, v = 0.01 * np.sin(rate * t), 0.01 * rate * np.cos(rate * t)
    seen = model.readings(model.nominal, [x, 5e-3 + 0 * x])
    decay, step = np.exp(-t[1] / tau), t[1] / tau
    sides = (1 - decay) / step
    filtered = lfilter([1 - sides, sides - decay], [1, -decay], seen, axis=1)[:, ::fine]  # linear between
    known = {"d1_x_ref_m": v[::fine], "d2_x_ref_m": -(rate**2) * x[::fine]}
    state = [known.get(c, 0 * v[::fine]) for c in late.state]
    values = late.vector({n: tau for n in late.names if n.startswith("tau_")})
    found = late.readings(values, [x[::fine], 5e-3 + 0 * x[::fine]], state)
    settled, size = t[::fine] > 0.1, np.abs(seen).max()
    assert np.abs(seen[:, ::fine] - filtered).max() > 0.01 * size
    assert np.abs(found - filtered)[:, settled].max() < 5e-6 * size


def test_gains_and_the_field_have_one_free_factor():
    """The mean gain is 1, whatever is added; a stated amplitude makes gains absolute. All are determined."""
    true = np.random.default_rng(2960).normal(0.02, 0.02, 9)
    model, effects = halbach(NINE), ["gain_mismatch"]
    log = example_log(transducer.gain_mismatch(model), {f"gain_{k}": g for k, g in enumerate(true.tolist())})
    for added in ([], ["offset_error"]):
        fit = hallsym.fit(log, model, effects=[*effects, *added], solver="direct")
        own = [fit.model.names.index(f"gain_{k}") for k in range(9)]
        gains, std = fit.values[own], fit.std[own]
        assert fit.determined.all()
        assert (fit.structural, fit.combinations, len(fit.gauges)) == ((), (), 1)
        assert abs(gains.mean()) < 1e-12
        assert np.abs((1 + gains - (1 + true) / (1 + true).mean()) / std).max() < 3.5
        assert fit.covariance[np.ix_(own, own)].sum() < 1e-9 * (std**2).sum()
    profiled = profile(fit.likelihood, fit.values, parameter(fit.model, "gain_3"), found=fit.determination)
    assert profiled.interval == pytest.approx(fit.conf_int()["gain_3"], abs=0.05 * std[3])
    found = hallsym.identify(fit, profiles="none")
    assert found.structural.rank == found.structural.of - 1
    assert [one.summary().count("one common factor") for one in (fit, found)] == [1, 1]
    stated = model.with_parameters({"a1": {"nominal": 0.62, "lower": 0.62, "upper": 0.62}})
    fit = hallsym.fit(log, stated, effects=effects, solver="direct")
    assert fit.gauges == ()
    assert np.abs((fit.values[own] - true) / fit.std[own]).max() < 3.5


# -- layouts and bad input -----------------------------------------------------------------------------------


def test_two_sensors_half_a_wavelength_apart_tell_no_position():
    with pytest.raises(InputError, match="at least two sensors"):
        halbach(columns((0.0, 0.015)))
    with pytest.raises(InputError, match="at least two sensors"):
        halbach(columns((0.0,)))


def _claimed(column, change):
    """Names of claims of a log in which a column is changed."""
    log = example_log(halbach(NINE))
    return _names(altered(log, **{column: change(log.array(column))}))


def _names(log):
    try:
        claims = hallsym.fit(log, halbach(NINE), solver="direct").claims
    except InputError as error:
        claims = error.claims
    assert all(len(claim.text) <= 400 for claim in claims)
    return [claim.name for claim in claims]


@pytest.mark.slow
def test_logs_that_no_array_can_have_made_are_claimed():
    assert _claimed("x_ref_m", lambda x: x + 0.4) == ["beyond"]
    assert _claimed("x_ref_m", lambda x: 1e-2 * x) == ["scale"]
    assert "unrelated" in _claimed("x_ref_m", np.random.default_rng(0).permutation)
    log = example_log(halbach(NINE))
    short = np.abs(log.array("x_ref_m") - np.median(log.array("x_ref_m"))) < 1e-3
    short_log = Log.from_arrays({c: log.array(c)[short] for c in log.columns}, log.noise)
    assert "short_travel" in _names(short_log)
    assert _claimed("z_ref_m", lambda z: z - z.mean()) == ["gap"]
    assert _claimed("z_ref_m", lambda z: z) == []


@pytest.mark.slow
def test_another_wavelength_and_a_silent_sensor_are_far_from_the_noise():
    model, log = halbach(NINE), example_log(halbach(NINE))
    known = hallsym.fit(log, model, solver="direct")
    scaled = {(c, f): f * log.array(c) for c, f in (("col_3_v", 0.01), ("x_ref_m", 1.25), ("col_3_v", 10.0))}
    silent, *lost = (altered(log, **{c: v}) for (c, _), v in scaled.items())
    fit = hallsym.fit(silent, model, solver="direct", loss="none")
    assert fit.goodness is not None
    assert fit.goodness.worst > 30 * fit.goodness.limit
    says = (r"does not describe .* run .*give no pose", r"undo it with --correct 'scale col_3_v 0.1'")
    for other, said in zip(lost, says, strict=True):
        with pytest.raises(InputError, match=said):
            hallsym.fit(other, model, solver="direct", loss="none")
    with pytest.raises(InputError, match="give no pose"):
        hallsym.evaluate(known, other)
