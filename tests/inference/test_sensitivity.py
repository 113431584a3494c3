"""What a recording determines: ranks, verdicts, effects, zero deviations; for any family."""

from dataclasses import replace

import numpy as np
import pytest
from twins import SIGMAS, TRUTH, record, true_model, with_noise

from hallsym import Fit, InputError, bundled_campaign, families, fit
from hallsym.families import build, published
from hallsym.inference import identify
from hallsym.log import Log, Meta, Noise
from hallsym.simulation import (
    Campaign,
    NoiseModel,
    Run,
    campaign_from,
    multi_sine,
    paper_campaign,
    simulate,
    sine,
)

PAIRS = [("H1x", "H1y"), ("H2x", "H2y"), ("H3x", "H3y")]


def multi_sine_campaign() -> Campaign:
    """All three axes move at once at each of Table 6's settings."""
    s = published.table("table6_settings")
    moves = {
        "x_m": multi_sine(300e-6, [1.0, 4.0, 7.0]),
        "y_m": multi_sine(500e-6, [2.0, 5.0, 8.0]),
        "rz_rad": multi_sine(300e-6, [3.0, 6.0, 9.0]),
    }
    axes = ("z_m", "rx_rad", "ry_rad")
    return Campaign(5e-3, tuple(Run(1.0, {a: s[a][k] for a in axes}, moves) for k in range(19)))


def level_campaign() -> Campaign:
    """One height: gains cannot be seen to follow it."""
    moves = {"x_m": sine(3e-4, 1.0), "y_m": sine(5e-4, 1.5), "rz_rad": sine(3e-4, 2.5)}
    return Campaign(0.01, (Run(2.0, {}, moves),))


CAMPAIGNS = {"one-axis sines": paper_campaign(0.02), "combined multi-sines": multi_sine_campaign()}


@pytest.fixture(scope="module")
def fitted():
    return fit(bundled_campaign(), "stage31", solver="direct")


@pytest.fixture(scope="module")
def report(fitted):
    return identify(fitted)


@pytest.mark.parametrize("campaign", CAMPAIGNS.values(), ids=CAMPAIGNS)
def test_structural_rank_is_18_of_21_and_names_the_pairs_of_h(campaign):
    found = identify(build("stage31"), campaign, values=TRUTH, noise=SIGMAS)
    assert (found.structural.rank, found.structural.of) == (18, 21)
    assert [d.parameters for d in found.structural.null] == PAIRS
    assert (found.practical.rank, found.practical.null) == (18, ())
    for direction, arm in zip(found.structural.null, ("H1x*cos", "-H2x*cos", "H3x*sin"), strict=True):
        assert direction.determined[0].startswith(arm)
        assert 0 < next(c.std for c in found.combinations if c.expression in direction.determined) < 1e-3
    for pair in PAIRS:
        assert all(found[name].verdict.word == "not determined" for name in pair)


@pytest.mark.parametrize("campaign", CAMPAIGNS.values(), ids=CAMPAIGNS)
def test_finite_rotation_lifts_the_null_directions_by_too_little_to_use(campaign):
    """No direction is structurally null with exact rotation; the data leave three, wider than bounds."""
    found = identify(build("stage31", added=("exact_rotation",)), campaign, values=TRUTH, noise=SIGMAS)
    assert (found.structural.rank, found.structural.of) == (21, 21)
    assert found.practical.rank == 18
    scale = np.outer(found.evidence.found.scale, found.evidence.found.scale)
    spectrum = np.sqrt(np.linalg.eigvalsh(found.evidence.information * scale)[::-1])
    assert spectrum[17] > 100  # a hundredth of the bounds
    assert np.all(spectrum[18:] < 1)  # beyond the bounds
    assert np.all(spectrum[18:] > 1e-3)  # not rounding


def test_the_tied_coupling_determines_h_on_the_same_log():
    log = with_noise(record(seed=1, name="stage31_tied"))
    free, tied = (
        identify(fit(log, "stage31", solver="direct")),
        identify(fit(log, "stage31_tied", solver="direct")),
    )
    assert (tied.structural.rank, tied.structural.of) == (17, 17)
    for name in ("H1y", "H2y", "H3x"):
        assert free[name].verdict.word == "not determined"
        assert tied[name].verdict.word == "determined"
        assert abs(tied[name].value - TRUTH[name]) < 4.5 * tied[name].std


def test_a_level_campaign_leaves_what_only_height_could_tell():
    found = identify(build("stage31"), level_campaign(), values=TRUTH, noise=SIGMAS)
    for name in (f"{q}_{k}" for q in "abc" for k in "ABC"):
        assert found[name].verdict.word == "no effect"
        assert found[name].std is None
    lost = [d.parameters for d in found.practical.null]
    assert sorted(lost) == sorted((f"{q}_{k}",) for q in "abc" for k in "ABC")
    assert found.practical.rank == 9
    assert found.structural.rank == 18


@pytest.mark.slow
def test_a_fixed_parameter_is_said_to_be_fixed_and_one_at_its_bound_to_be_there(fitted):
    log = bundled_campaign()
    changes = {
        "theta_A": {"nominal": 0.0, "lower": 0.0, "upper": 0.0},
        "eta_B": {"nominal": 0.70, "lower": 0.65, "upper": 0.70},
    }
    found = identify(fit(log, "stage31", solver="direct", parameters=changes))
    assert found["theta_A"].verdict.word == "fixed"
    assert found["eta_B"].verdict.word == "at bound"
    assert "upper bound 0.7" in found["eta_B"].verdict.because
    assert found["eta_B"].interval.how == "profile"
    assert found["eta_B"].interval.high == pytest.approx(0.70)
    assert found.structural.of == 20


def test_effect_of_a_parameter_is_what_the_decoder_does(report, fitted):
    """1 % of eta_A through the decoder itself, at the readings of the log, zero deviations held."""
    model, log, weight = fitted.model, bundled_campaign(), np.ones(3)
    readings = [log.array(c) for c in model.channels]
    states = [log.array(c) for c in model.state]
    p = fitted.values.copy()
    before = model.decode(p, np.zeros(3), readings, states, weight)
    k = model.names.index("eta_A")
    for factor in (1.0001, 0.9999):
        q = p.copy()
        q[k] *= factor
        moved = np.abs(model.decode(q, np.zeros(3), readings, states, weight) - before).max(axis=1) / 1e-4
        for column, worst in zip(model.pose, moved, strict=True):
            said = report["eta_A"].percent.worst[column] * 100
            assert said == pytest.approx(worst, rel=0.05)  # zeros and thinning of the workspace


def test_a_plan_says_what_the_recording_then_does():
    """Planned standard uncertainties are those of a fit to the recording, to the noise in its own weights."""
    campaign = paper_campaign(0.02)
    model = true_model()
    planned = identify(model, campaign, values=TRUTH, noise=SIGMAS)
    log = with_noise(simulate(model, TRUTH, campaign, NoiseModel(SIGMAS), seed=3))
    recorded = identify(fit(log, model, solver="direct"), profiles="none")
    for entry in planned.parameters:
        if entry.std is not None:
            assert recorded[entry.name].std == pytest.approx(entry.std, rel=0.05), entry.name
    assert [d.parameters for d in recorded.structural.null] == [d.parameters for d in planned.structural.null]


@pytest.mark.slow
def test_zero_deviations_scatter_as_much_as_their_uncertainty_says():
    """20 recordings x 171 zeros: the standardised errors have a mean square of 1 to 2.4 % (1 sigma)."""
    runs = paper_campaign().runs
    squares = []
    for seed in range(20):
        log = with_noise(record(seed=100 + seed))
        told = identify(fit(log, true_model(), solver="direct", loss="none"), profiles="none")
        offsets = told.offsets
        assert (offsets.names, offsets.runs) == (("delta_A", "delta_B", "delta_C"), tuple(range(len(runs))))
        true = np.array([run.offsets for run in runs])
        squares.append(((offsets.values - true) / offsets.std) ** 2)
        assert offsets.values.size == 171
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1)


# -- bad input -------------------------------------------------------------------------------------------


def elsewhere() -> Log:
    """The bundled log, of probes at other places."""
    log = bundled_campaign()
    probes = [
        {"channel": f"hall_{k}_m", "position_m": [x, y], "senses": s}
        for k, x, y, s in (("a", 0.1, 0.2, [0, 1]), ("b", -0.1, 0.2, [0, 1]), ("c", 0.1, 0.3, [1, 0]))
    ]
    return replace(Log.from_arrays({c: log.array(c) for c in log.columns}), meta=Meta(probes=probes))


def few() -> Fit:
    """A fit of eight samples of one run."""
    columns = record(seed=2, samples=200)
    at = np.flatnonzero(columns["run"] == 0)[::25]
    return fit(with_noise({c: v[at] for c, v in columns.items()}), "stage31", solver="direct", loss="none")


def silent() -> dict[str, float]:
    return {c: s for c, s in SIGMAS.items() if c != "hall_b_m"}


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (lambda _: identify(build("stage31")), "give a campaign"),
        (lambda fitted: identify(fitted.changed(likelihood=None)), "does not hold its log"),
        (lambda fitted: identify(fitted, elsewhere()), "another machine, or another layout"),
        (lambda _: identify(few()), "too few to form a covariance"),
        (
            lambda _: identify(build("stage31"), paper_campaign(0.05), values=TRUTH, noise=silent()),
            "hall_b_m has none",
        ),
    ],
)
def test_what_determines_nothing_is_refused_in_one_sentence(fitted, asked, said):
    with pytest.raises(InputError, match=said):
        asked(fitted)


def test_another_log_of_a_changed_machine_is_told(fitted):
    columns = simulate(
        build("stage31"), TRUTH | {"eta_A": 0.80}, paper_campaign(0.02), NoiseModel(SIGMAS), seed=5
    )
    found = identify(fitted, with_noise(columns), profiles="none")
    assert any("not the log" in note and "eta_A" in note for note in found.evidence.notes)
    assert found["eta_A"].value == pytest.approx(0.80, abs=1e-3)


# -- verdicts and null directions say the same ------------------------------------------------------------


def contradictions(found) -> list[str]:
    """Return the parameters of which the table says one thing and the null directions another."""
    always = {name for d in found.structural.null for name in d.parameters}
    here = {name for d in found.practical.null for name in d.parameters}
    wrong = []
    for entry in found.parameters:
        word, because = entry.verdict.word, entry.verdict.because
        if word in ("determined", "weak") and entry.name in always:
            wrong.append(f"{entry.name}: {word}, and in a structural direction")
        if word == "not determined" and entry.name not in always | here:
            wrong.append(f"{entry.name}: {word}, and in no direction")
        if "by this recording" in because and entry.name not in here:
            wrong.append(f"{entry.name}: {because}, and this recording loses nothing of it")
        if "from any recording" in because and entry.name not in always:
            wrong.append(f"{entry.name}: {because}, and structurally determined")
    return wrong


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.slow] if n == "halbach_planar" else [])
        for n in sorted(families.models())
    ],
)
def test_no_verdict_contradicts_the_null_directions_of_an_example(name):
    model = build(name)
    example = model.family.example
    campaign = campaign_from(example.campaign, name) if example else paper_campaign(0.05)
    noise = Noise.given(example.noise, (*model.channels, *model.references)).std if example else SIGMAS
    values = {n: v for n, v in (example.values if example else TRUTH).items() if n in model.names}
    assert contradictions(identify(model, campaign, values=values, noise=noise)) == []
