"""Every threshold of the policy decides something: each has a test here that fails without it.

A stage is a function of records, so most tests give it small records made by hand. The others diagnose small
simulated logs twice, with the policy and with one threshold switched off.
"""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_twins import listed
from gap_twins import machine as stage
from test_compare import diagnosis
from test_compare import effect as effect_record
from test_diagnosis_holding import turn
from test_diagnosis_rotary import machine, third
from test_diagnosis_turn import LIKE_A_TABLE, table

from hallsym.diagnosis import (
    POLICY,
    Diagnosis,
    Exact,
    Floor,
    Key,
    LackOfFit,
    Policy,
    Score,
    Shape,
    cancels,
    compare,
    confusable,
    decide,
    diagnose,
    ordered,
    prepare,
    rails_of,
    refit,
    remains,
    select,
    separation,
    smaller_findings,
    with_model,
)
from hallsym.families import effect_named
from hallsym.log import Log

CONFUSABLE, SELECTION = (sys.modules[f"hallsym.diagnosis.{name}"] for name in ("confusable", "selection"))
"""The modules; the package has functions of these names."""

LEVEL = 0.05
FLOOR = Floor(1e-6, stated=True)
CLEAN = LackOfFit(())


def shaped(drop: float, p: float, kind: str = "place") -> LackOfFit:
    return LackOfFit((Shape(Key(kind, "x"), drop, p),))


# -- is what is left a gap, and the verdict ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("found", "excess", "error", "gap"),
    [
        (CLEAN, 1.08, 0.0, False),  # 5 % above a floor that is known to 3 %
        (CLEAN, 1.09, 0.0, True),
        (CLEAN, 1.15, 0.01, True),
        (CLEAN, 1.15, 0.05, False),  # noise with a long memory makes as much by chance
        (shaped(0.2, 0.2), 0.5, 0.0, False),
        (shaped(0.2, 0.01), 0.5, 0.0, True),  # a shape is a gap whatever the floor is said to be
    ],
)
def test_what_is_left_is_a_gap_above_a_stated_floor_or_with_a_shape(found, excess, error, gap):
    assert remains(found, excess * FLOOR.metric, FLOOR, LEVEL, POLICY, error) is gap
    if found is CLEAN:
        assert not remains(found, excess * FLOOR.metric, Floor(1e-6, stated=False), LEVEL, POLICY, error)


def validated(after: float, rest: LackOfFit) -> SimpleNamespace:
    """A validation that names an effect which lowers a gap of 4 um to `after`."""
    end = object()
    return SimpleNamespace(
        named=True, metric=after, before=SimpleNamespace(metric=4e-6), base=end, end=end, rest=rest,
        floor=FLOOR, error=0.0,
    )  # fmt: skip


def test_a_gap_is_explained_only_where_nearly_all_is_closed():
    setup = SimpleNamespace(threshold=LEVEL, policy=POLICY, runs=[])
    bent = shaped(0.3, 1e-6)
    assert decide(setup, validated(2e-6, bent)) == "unexplained"  # four fifths of the excess
    assert decide(setup, validated(2e-6, CLEAN)) == "unexplained"  # twice the floor, stated, without a shape
    assert decide(setup, validated(1.1e-6, bent)) == "explained"
    setup.policy = replace(POLICY, minor=0.5)
    assert decide(setup, validated(2e-6, bent)) == "explained"


# -- which of two effects ----------------------------------------------------------------------------------


def effect(name: str, size: int, cost: float, gap: float, ratio: float = 0.5, bic: float = 0.0) -> Exact:
    """An exact refit that leaves squares `cost` of 1000 and the gap metric `gap`."""
    score = Score(
        SimpleNamespace(name=name, separate=()),
        SimpleNamespace(tried=1),
        None,
        1000 - cost,
        size,
        bic,
        ratio,
        1e-9,
    )
    fit = SimpleNamespace(
        cost=cost, metric=gap, readings=1000.0, distance=lambda _: 1.0,
        variance=lambda inflation: inflation * cost / 1000.0,
        base=SimpleNamespace(model=SimpleNamespace(channels=("a", "b"), effects=())),
    )  # fmt: skip
    return Exact(score, fit, bic)


def first(exact: list[Exact], policy: Policy = POLICY) -> str:
    scored = [e.score for e in exact]
    return ordered(exact, scored, lambda _: True, policy)[0].score.effect.name


def test_fewer_parameters_win_if_they_explain_nearly_as_much():
    flexible = effect("flexible", 6, 100.0, 1.0e-6, bic=-90.0)
    plain = effect("plain", 2, 110.0, 1.005e-6, bic=-80.0)
    assert first([flexible, plain]) == "plain"
    assert first([flexible, plain], replace(POLICY, negligible=0.001)) == "flexible"


def test_a_plain_variant_holds_the_place_only_where_it_is_as_good():
    """Two parameters of one cause, of which one alone leaves more than another cause's only one."""
    flexible = effect("flexible", 2, 100.0, 1.0e-6, bic=-90.0)
    plain = effect("plain", 1, 102.0, 1.001e-6, bic=-89.0)
    variant = replace(flexible.score, size=1, gain=plain.score.gain - 1.0, bic=plain.score.bic + 18.0)
    exact, scored = [flexible, plain], [flexible.score, plain.score, variant]

    def winner(policy: Policy) -> str:
        return ordered(exact, scored, lambda _: True, policy)[0].score.effect.name

    assert winner(POLICY) == "plain"
    assert winner(replace(POLICY, as_good=20.0)) == "flexible"


# -- confusable effects, and what separates them -------------------------------------------------------------


def selected(one: Exact, *rivals: Exact) -> SimpleNamespace:
    """A validation that holds one effect, whose place others were refitted for."""
    held = SimpleNamespace(name=one.name, exact=replace(one, rivals=rivals, squares_before=2000.0))
    return SimpleNamespace(effects=(held,), inflation=1.0)


def test_a_rival_must_fit_as_well_and_need_its_parameters(monkeypatch):
    """1000 squares of 1000 readings: 5 sigma of a slow average are 25."""
    monkeypatch.setattr(CONFUSABLE, "separation", lambda names, *_: SimpleNamespace(group=tuple(names)))
    model = SimpleNamespace(pose=("x_m",), family=SimpleNamespace(pairs=True))
    setup = SimpleNamespace(policy=POLICY, base=SimpleNamespace(model=model))
    one, near, far = (effect(n, 2, 1000.0 + c, 1e-6) for n, c in (("one", 0), ("near", 20), ("far", 30)))
    wide = effect("wide", 6, 1000.0, 1e-6, bic=30.0)

    def groups(policy: Policy) -> tuple[tuple[str, ...], ...]:
        setup.policy = policy
        return confusable(setup, selected(one, near, far, wide), (), "explained").groups

    assert groups(POLICY) == (("one", "near"),)
    assert groups(replace(POLICY, separated=3.0)) == ()
    assert groups(replace(POLICY, separated=6.0)) == (("one", "near", "far"),)
    assert groups(replace(POLICY, as_good=np.inf)) == (("one", "near", "wide"),)


def test_the_plainest_recording_is_proposed_if_it_separates_nearly_as_well(monkeypatch):
    tried = [SimpleNamespace(text=t, run=SimpleNamespace(duration_s=8.0)) for t in ("plain", "best")]
    monkeypatch.setattr(
        sys.modules["hallsym.diagnosis.confusable"], "simulated", lambda _: (tried, np.array([16.0, 25.0]))
    )
    model = SimpleNamespace(family=SimpleNamespace(further=()))
    fits = [SimpleNamespace(base=SimpleNamespace(timed=True, model=model))]

    def proposed(policy: Policy) -> tuple[str, int | None]:
        s = separation(("a", "b"), fits, 0.0, 1.0, "advice", policy)
        return s.recording, s.runs

    assert proposed(POLICY) == ("plain", 2)
    assert proposed(replace(POLICY, mostly=0.9)) == ("best", 1)
    assert proposed(replace(POLICY, most_runs=1)) == ("advice", None)
    assert proposed(replace(POLICY, separated=10.0)) == ("plain", 7)


# -- smaller findings --------------------------------------------------------------------------------------


def test_smaller_findings_are_certain_and_below_the_threshold():
    def scored(name: str, shrinkage: float, p: float) -> Score:
        variant = SimpleNamespace(tried=1)
        return Score(SimpleNamespace(name=name), variant, None, 1.0, 1, 0.0, 1 - shrinkage, p)

    last = [scored("real", 0.03, 1e-6), scored("chance", 0.03, 0.02), scored("large", 0.08, 1e-6)]
    last.append(scored("tiny", 0.004, 1e-6))
    setup = SimpleNamespace(tested=20, threshold=LEVEL, policy=POLICY)
    selection, found = SimpleNamespace(last=last), SimpleNamespace(effects=())
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real"]
    setup.policy = replace(POLICY, certain=0.1)
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real", "chance"]
    setup.policy = replace(POLICY, minor=0.0)
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real", "tiny"]


# -- input -------------------------------------------------------------------------------------------------


def runs_of(count: int) -> Log:
    """So many runs of an encoder without a cause, no holdout runs named."""
    whole = machine()
    keep = whole.array("run") < count
    return Log.from_arrays({c: whole.array(c)[keep] for c in whole.columns}, whole.noise)


def test_the_threshold_and_the_holdout_runs_follow_the_policy():
    setup = prepare(runs_of(8), "ellipse")
    assert (setup.threshold, setup.holdout, setup.split) == (POLICY.worth_reporting, (2, 7), False)
    other = replace(POLICY, worth_reporting=0.2, holdout_every=3)
    setup = prepare(runs_of(8), "ellipse", policy=other)
    assert (setup.threshold, setup.holdout) == (0.2, (1, 4, 7))


def test_a_recording_of_fewer_runs_is_split():
    assert not prepare(runs_of(3), "ellipse").split
    assert prepare(turn(), "rotary").split


def test_a_turning_point_on_one_step_of_the_converter_is_no_rail():
    values = np.concatenate(
        [np.linspace(-0.9, 0.9, 50), [1.0] * (POLICY.rail_repeats - 1), [-1.0] * POLICY.rail_repeats]
    )
    assert rails_of(values[None]) == ((-1.0, np.inf),)


# -- comparison --------------------------------------------------------------------------------------------


def test_floors_that_differ_are_noted():
    def floor(times: float) -> dict:
        return diagnosis(metric={"before": 3e-6, "after": 1.5e-6, "floor": times * 1e-6})

    assert not compare(floor(1.0), floor(1 + POLICY.unstructured - 0.01)).notes
    assert "noise floors differ" in compare(floor(1.0), floor(1 + POLICY.unstructured + 0.01)).notes[0]


def test_a_change_is_significant_at_five_per_cent():
    """Two standard uncertainties of 1: a difference of 1.96 sqrt(2) has p = .05."""

    def record(value: float) -> dict:
        return diagnosis(effect_record("e", a=(value, 1.0)))

    assert POLICY.false_alarm == 0.05
    for times, significant in ((1.95, False), (1.97, True)):
        (change,) = compare(record(0.0), record(times * np.sqrt(2))).effects[0].parameters
        assert change.significant is significant


# -- whole diagnoses, with the policy and with one threshold switched off -----------------------------------


def clipped() -> Log:
    log = machine()
    columns = {c: log.array(c) for c in log.columns}
    for c in ("v_sin_v", "v_cos_v"):
        columns[c] = np.clip(columns[c], -0.97, 0.97)
    return Log.from_arrays(columns, log.noise, log.meta, "a clipped encoder")


def without(log: Log, model: str, **gates: float) -> tuple[Diagnosis, Diagnosis]:
    """Return the diagnosis with the policy and with some thresholds replaced."""
    return diagnose(log, model), diagnose(log, model, policy=replace(POLICY, **gates))


@pytest.mark.slow
def test_two_plain_effects_win_against_a_flexible_one(monkeypatch):
    """One harmonic, an offset and a gain mismatch: a tilt of the magnet would take all along."""
    kept = diagnose(machine(third), "rotary_ideal")
    monkeypatch.setattr(SELECTION, "plain_pairs_first", lambda exact, *_: exact)
    off = diagnose(machine(third), "rotary_ideal")
    assert kept.verdict == "explained"
    assert "third_harmonic_distortion" in kept.ranked
    assert (off.verdict, off.ranked) == ("unexplained", ("magnet_tilt",))


def test_a_flexible_effect_stays_where_a_second_one_beside_it_leaves_far_less(monkeypatch):
    """Two plain effects leave 300 squares with fewer parameters, the flexible one and a second one 100."""
    flexible, plain = effect("flexible", 4, 400.0, 1e-6, bic=50.0), effect("plain", 1, 450.0, 1e-6)
    gains = {"flexible": 300.0, "plain": 150.0}
    monkeypatch.setattr(
        SELECTION, "_second", lambda e, *_: SimpleNamespace(gain=gains[e.score.effect.name], size=1, bic=0.0)
    )

    def best(policy: Policy) -> str:
        order = SELECTION.plain_pairs_first([flexible, plain], (), (), None, policy)
        return str(order[0].score.effect.name)

    assert best(POLICY) == "flexible"
    assert best(replace(POLICY, half=0.0)) == "plain"


@pytest.mark.parametrize(
    ("text", "undone"), [("even_nonlinearity", False), ("even_nonlinearity:order=4", True)]
)
def test_an_effect_whose_parameters_undo_each_other_is_rejected(text, undone):
    """Where the data ask for neither, a square and a fourth power grow until they cancel."""
    setup = prepare(table(LIKE_A_TABLE), "rotary")
    wide = effect_named(text, setup.base.model).added(setup.base.model, text)
    fit = refit(with_model(setup.base, wide), setup.runs)
    assert cancels(fit, [n for n in wide.names if n not in setup.base.model.names], POLICY.half) is undone


def test_few_runs_judge_without_an_interval():
    few = diagnose(machine(third), "ellipse", policy=replace(POLICY, fewest=9))
    enough = diagnose(machine(third), "ellipse")
    assert (few.shrinkage.interval, few.shrinkage.judges) == (None, 8)
    assert enough.shrinkage.interval[0] < enough.shrinkage.value < enough.shrinkage.interval[1]


@pytest.mark.slow
def test_clipping_is_judged_by_the_holdout_runs():
    """The score is that of a tangent, which knows nothing of a rail."""
    kept, off = without(clipped(), "ellipse", half=0.0)
    assert (kept.ranked[0], off.ranked[0]) == ("saturation", "saturation")
    assert kept.effects[0].p_value != off.effects[0].p_value


@pytest.mark.parametrize("gate", ["most_refits", "mostly"])
def test_effects_that_explain_nearly_as_much_are_refitted_too(gate):
    setup = prepare(machine(third), "ellipse")
    (kept,), (off,) = (
        select(replace(setup, policy=policy)).effects for policy in (POLICY, replace(POLICY, **{gate: 1}))
    )
    alike = {kept.name, *(r.name for r in kept.rivals)}
    assert alike == {"third_harmonic_distortion", "field_saturation", "odd_nonlinearity"}
    assert off.rivals == ()


@pytest.mark.slow
def test_noise_is_taken_for_correlated_while_searching():
    """Twice the variance in slow averages: half as many readings count, so fewer parameters pay.

    A phase of 30 mrad is 3 sigma of white noise.
    """

    def turned(u, w, run, t):
        return 0.0, 2e-3 * np.sin(3 * u + 0.03), -2e-3 * np.cos(3 * u + 0.03), 0.0

    kept, off = without(machine(turned), "ellipse", inflation=1.0)
    assert [e.text for e in kept.effects] == ["third_harmonic_distortion"]
    assert [e.text for e in off.effects] == ["third_harmonic_distortion:phase=free"]
    assert kept.metric.after < 1.01 * off.metric.after


@pytest.mark.slow
def test_a_rail_is_refitted_from_several_starts():
    log = stage("raster", (listed(np.random.default_rng(1))["saturation"],), seed=1, thin=6)
    kept, off = without(log, "stage31", starts=1)
    assert kept.metric.after < 1.1 * kept.metric.floor
    assert off.metric.after > 1.5 * off.metric.floor


def test_a_plainer_form_is_refitted_before_a_lesser_effect_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quintic term that a cubic one undoes falls; the cubic one alone is the cause, and no rail."""

    def score(name: str, size: int, gain: float) -> SimpleNamespace:
        made = SimpleNamespace(name=name, possible=lambda values: True)
        return SimpleNamespace(
            effect=made,
            size=size,
            gain=gain,
            ratio=0.8,
            absorbed=False,
            bic=-gain,
            variant=SimpleNamespace(tried=1),
        )

    bent, cubic, rail = score("bent", 6, 100.0), score("bent", 3, 99.0), score("rail", 3, 80.0)
    monkeypatch.setattr(
        SELECTION, "by_name", lambda s: list({x.effect.name: x for x in reversed(s)}.values())
    )
    monkeypatch.setattr(SELECTION, "_finer", lambda base, s, *_: s)
    fit = SimpleNamespace(base=SimpleNamespace(values={}))
    monkeypatch.setattr(
        SELECTION, "_exact", lambda base, s, *_: SimpleNamespace(score=s, fit=fit, bic=-s.gain)
    )
    monkeypatch.setattr(SELECTION, "ordered", lambda out, *_: sorted(out, key=lambda e: e.bic))
    best, *_ = SELECTION.refitted(
        (), [bent, cubic, rail], (), None, lambda s: True, lambda e: e.score is not bent
    )
    assert best.score is cubic
