"""A family that hallsym does not know goes through every verb: nothing in hallsym is edited for it.

The array is in `trial_families`. Independent facts: a second harmonic of the field makes
three waves of error per period of x (Maguire, UBC 2015, section 2.6); what was simulated is what is found.
"""

import json
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from firmware import need, ran
from recordings import Size, machine
from trial_families import ARRAY, second_harmonic
from twins import example_log

import hallsym
from hallsym import InputError, Log, Meta, families
from hallsym.cli.main import main
from hallsym.families import FAMILIES, machine_file, suggest
from hallsym.log import continuous, near, open_source, wrapped
from hallsym.model import Family, effect
from hallsym.report.results import info
from hallsym.report.views import summary
from hallsym.simulation import campaign_from

HARMONIC = {"h2c": 3e-3, "h2s": 1e-3}
BOX = {"x_m": (-1e-2, 1e-2), "z_m": (4e-3, 6e-3)}
each_family = pytest.mark.parametrize("family", [*FAMILIES, ARRAY], ids=str)


@cache
def fitted() -> tuple[Log, hallsym.Fit]:
    model = ARRAY.models[0]()
    log = example_log(model)
    return log, hallsym.fit(log, model, solver="direct")


# -- what every family states ------------------------------------------------------------------------------


@each_family
def test_a_record_is_whole(family):
    names = [make.__name__ for make in family.models]
    assert len(set(names)) == len(names)
    assert set(family.aliases.values()) <= set(names)
    assert family.model_of(family.models[0]().references) == (family.default or names[0])
    for make in family.models:
        model = make()
        assert model.family is family
        assert model.name == make.__name__
        assert len(model.references) == len(model.pose)
        assert family.references in ((), model.references)
        assert {*model.pose, *model.state} <= set(family.axes)
        assert family.reads((*model.channels, *model.references))
        assert set(model.homes.values()) <= set(model.period)
        assert set(model.period) <= {*model.pose, *model.references, *model.channels, *model.names}
        for coordinate, reference in zip(model.pose, model.references, strict=True):
            assert model.period.get(coordinate) == model.period.get(reference)
        assert np.all(family.pose_metric.weights(model.pose) == family.pose_metric.weights(model.references))
        assert model.zero_scale(model.nominal, np.zeros(len(model.state))).shape == (len(model.offsets),)


@each_family
def test_a_model_decodes_what_it_reads(family):
    for make in family.models:
        model = make()
        rng = np.random.default_rng(1)
        zeros = np.zeros(len(model.offsets))
        state = np.zeros(len(model.state))
        for pose in model.typical or (1e-4 * rng.standard_normal(len(model.pose)),):
            reading = model.reading(model.nominal, zeros, pose, state)
            weight = np.ones(len(model.channels))
            found = np.asarray(model.decoded(model.nominal, zeros, reading, state, weight)).ravel()
            assert np.abs(near(model, found, pose) - pose).max() < 1e-9


# -- every verb --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", ["closed form", "none"])
def test_a_fit_finds_what_was_simulated(start):
    log, fit = fitted()
    if start == "none":
        fit = hallsym.fit(log, replace(fit.model, closed_form=None), solver="direct")
    assert fit.status == "converged"
    for k, name in enumerate(fit.model.names):
        assert abs(fit.values[k] - ARRAY.example.values.get(name, fit.model.nominal[k])) < 5 * fit.std[k]
    rmse = fit.errors.rows()["fitted"]["rmse"]
    for coordinate, floor in fit.noise_floor.items():
        assert rmse[coordinate] == pytest.approx(floor, rel=0.15)


def test_a_calibration_and_its_effect_are_saved_by_their_names(tmp_path):
    model = ARRAY.models[0]()
    fit = hallsym.fit(example_log(second_harmonic(model), HARMONIC), model, effects=["second_harmonic"])
    fit.save(tmp_path / "calib.json")
    assert json.loads((tmp_path / "calib.json").read_text())["added"] == ["second_harmonic"]
    known = hallsym.load_fit(tmp_path / "calib.json", families=(ARRAY,))
    assert known.model.family is ARRAY
    assert np.array_equal(known.values, fit.values)
    with pytest.raises(InputError, match="Model must be one of"):
        hallsym.load_fit(tmp_path / "calib.json")
    assert known.value("h2c") == pytest.approx(HARMONIC["h2c"], rel=0.05)


def test_an_effect_of_the_family_is_named():
    model = ARRAY.models[0]()
    found = hallsym.diagnose(example_log(second_harmonic(model), HARMONIC), model, holdout=[2])
    assert (found.verdict, found.ranked) == ("explained", ("second_harmonic",))
    assert found.metric.after < 1.1 * found.metric.floor
    (effect,) = found.effects
    assert effect.parameters["h2c"].value == pytest.approx(HARMONIC["h2c"], rel=0.05)


def test_the_waves_of_an_error_over_x_are_counted():
    """Nobody knows the effect: the error has three waves per period of x, and goes with the place in it."""
    model = ARRAY.models[0]()
    bare = replace(model, family=replace(ARRAY, effects=()))
    found = hallsym.diagnose(example_log(second_harmonic(model), HARMONIC), bare, holdout=[2])
    assert (found.verdict, found.ranked) == ("unexplained", ())
    largest = max(found.waves, key=lambda w: w.model)
    assert (largest.coordinate, largest.per_turn) == ("x_m", 3)
    assert largest.model == pytest.approx(5e-6, rel=0.1)
    assert found.where[0].by == "place in the period of x"
    assert found.where[0].share > 0.7
    assert "waves per period of x [um]" in summary(found)


def test_a_fit_is_drawn_and_says_what_is_determined_and_how_well_a_position_is_known(tmp_path):
    _, fit = fitted()
    fit.plot().savefig(tmp_path / "fit.png")
    structural = hallsym.identify(fit, profiles="none").structural
    assert structural.rank == structural.of == len(fit.model.names)
    for coordinate, budget in hallsym.position_budget(fit, {"z_m": 5e-3}).items():
        assert 0 < budget.std < 2 * fit.noise_floor[coordinate]
    found = hallsym.uncertainty_map(fit, {c: BOX[c] for c in ("x_m", "z_m")})
    assert np.isfinite(found.expanded).all()


def test_a_tolerance_has_a_worth():
    model = ARRAY.models[0]().with_parameters({n: {"nominal": v} for n, v in ARRAY.example.values.items()})
    ranges = {f"{n}_percent" if n[0] == "g" else n: 1.0 if n == "g0" else "exact" for n in model.names}
    campaign = campaign_from(ARRAY.example.campaign, "the example")
    found = hallsym.tolerances(model, campaign, ranges=ranges, samples=16)
    assert found.active == ("g0",)
    assert np.all(found.errors.rms > 0)


def test_the_detection_power_finds_its_effect():
    log, fit = fitted()
    found = hallsym.detection_power(
        log, fit.model, holdout=[2], names=["second_harmonic"], ratios=[3.0], repeats=1
    )
    (effect,) = found.effects
    assert effect.status == "found"
    assert found.false_alarms == 0


def test_its_lowering_gives_c(tmp_path):
    need("gcc", "make")
    _, fit = fitted()
    code = hallsym.generate(fit, ranges={"x_m": (-3e-4, 3e-4), "z_m": (4.8e-3, 5.2e-3)})
    assert max(code.bounds.error.values()) < 5e-9
    code.write(tmp_path / "fw")
    assert "table good, 0 of" in ran(tmp_path / "fw", "make", "check")


def test_a_family_without_a_lowering_is_refused_in_one_sentence():
    _, fit = fitted()
    alone = fit.changed(model=replace(fit.model, family=replace(ARRAY, decoder="linear")))
    with pytest.raises(InputError, match="brings no decoupler of its own"):
        hallsym.generate(alone)


def test_a_pose_is_decoded_on_the_controller_side():
    log, fit = fitted()
    readings, references = (
        np.array([log.array(c)[::97] for c in names]) for names in (fit.model.channels, fit.model.references)
    )
    decode = hallsym.decouple(fit)
    pose = np.array([np.asarray(decode(reading, np.zeros(0))).ravel() for reading in readings.T]).T
    for c, off in zip(fit.model.pose, near(fit.model, pose, references) - references, strict=True):
        assert np.abs(off).max() < 6 * fit.noise_floor[c]


def test_a_model_without_typical_poses_is_fitted_and_diagnosed():
    """Noise is then averaged at the zero pose alone."""
    log, fit = fitted()
    plain = replace(fit.model, typical=())
    known = hallsym.fit(log, plain, solver="direct")
    assert np.allclose(known.values, fit.values, rtol=0, atol=1e-2 * fit.std.max())
    assert set(known.noise_floor) == set(plain.pose)
    assert hallsym.diagnose(log, known, holdout=[2]).verdict in ("no gap", "unexplained")


# -- several periodic coordinates --------------------------------------------------------------------------


def test_each_reference_that_repeats_is_unwrapped_by_itself():
    planar = machine("planar", "folded", Size(5, 400, 5e-3))
    log, model, columns = planar.log, replace(planar.built, absolute=()), planar.arrays
    far = {c: columns[c] + np.linspace(0, 0.1, log.rows) for c in ("x_ref_m", "y_ref_m")}
    folded = columns | {c: wrapped(v, model.period[c]) for c, v in far.items()}
    whole = continuous(Log.from_arrays(folded), model)
    for c, v in far.items():
        for run in whole.runs:
            at = columns["run"] == run
            apart = np.concatenate([b.data[c] for b in whole.blocks((c,)) if b.run == run]) - v[at]
            assert np.ptp(apart) < 1e-12


# -- a family whose code fails -----------------------------------------------------------------------------


def broken_model(layout=None):
    """A model that cannot be built."""
    raise RuntimeError("no magnets")


@effect(link="transducer")
def offset_error(model):
    """An offset that cannot be added."""
    raise RuntimeError("no magnets")


BROKEN = Family(
    "broken",
    models=(broken_model,),
    default="broken_model",
    about="a ruin (x_ref_m)",
    effects=(offset_error,),
)
UNUSABLE = "Family broken cannot be used: its code fails (RuntimeError: no magnets)"


@pytest.fixture
def beside_a_broken_one(monkeypatch):
    """Register a family whose maker and effect raise beside all others."""
    for module in (families, info, suggest, machine_file):
        monkeypatch.setattr(module, "FAMILIES", (*FAMILIES, BROKEN))
    return BROKEN


def bare(log: Log) -> Log:
    """The log without any word of what it is of."""
    return Log.from_arrays({c: log.array(c) for c in log.columns}, log.noise)


@pytest.mark.parametrize("family", FAMILIES, ids=str)
def test_a_broken_family_harms_no_other(family, beside_a_broken_one):
    log = example_log(family.maker(family.default)()) if family.example else hallsym.bundled_campaign()
    model = families.build(families.default_model(Meta(columns=log.columns)))
    assert model.family is family
    assert families.model_for(model.pose) in (f.default for f in FAMILIES)
    assert set(model.pose) <= set(families.axes())
    found = suggest.suggest(open_source({c: log.array(c) for c in log.columns})[2])
    assert found.model.name == model.name


def test_a_log_is_fitted_and_diagnosed_beside_a_broken_family(beside_a_broken_one):
    log = example_log(families.build("rotary"))
    fit = hallsym.fit(bare(log), solver="direct")
    assert fit.model.name == "rotary"
    assert hallsym.diagnose(log, holdout=[2]).verdict == "no gap"


def test_a_broken_family_is_listed_and_said_to_be_broken_when_it_is_asked_for(beside_a_broken_one, capsys):
    assert main(["info"]) == 0
    assert "broken_model" in capsys.readouterr().out
    assert main(["info", "offset_error"]) == 0
    shown = capsys.readouterr().out
    assert f"offset_error of the broken family: {UNUSABLE}" in shown
    assert "offset_error of the rotary family, link transducer" in shown
    assert main(["info", "broken_model"]) == 2
    assert UNUSABLE in capsys.readouterr().err
    for asked in (families.build, lambda name: hallsym.fit(hallsym.bundled_campaign(), name)):
        with pytest.raises(InputError) as raised:
            asked("broken_model")
        assert str(raised.value).startswith(UNUSABLE)


def test_a_fit_runs_no_code_of_another_family():
    log, entered = hallsym.bundled_campaign(), set()

    def enter(frame, event, _):
        module = frame.f_globals.get("__name__", "")
        if module.startswith("hallsym.families."):
            entered.add(module.split(".")[2])

    before = sys.getprofile()
    sys.setprofile(enter)
    try:
        hallsym.fit(bare(log), solver="direct")
    finally:
        sys.setprofile(before)
    assert "stage" in entered
    assert not entered & {"rotary", "halbach"}
