"""What a fit claims of a recording: silent where a log is what it says; else what puts it right is named.

What is claimed of each kind of mistake stands in the table of `tests/log`.
"""

from itertools import permutations, product

import numpy as np
import pytest
import recordings
from recordings import Size, mistaken
from scipy.signal import lfilter
from twins import HALL, SIGMAS, record, same, six_runs, with_noise

from hallsym.errors import InputError
from hallsym.estimation import claims, fit, optimum
from hallsym.estimation.claims import mistakes_of
from hallsym.families import build, published
from hallsym.families.recording import Correction, as_corrections, corrected, read_correction
from hallsym.log import Log, Meta, Noise
from hallsym.simulation import NoiseModel, simulate
from hallsym.simulation.campaign import Campaign, Run
from hallsym.simulation.paper import VERTICAL_NOISE
from hallsym.simulation.signals import ramp, sine

WIRINGS = [(p, s) for p in permutations(range(3)) for s in product((1, -1), repeat=3)]
QUICK = [((2, 0, 1), (1, -1, 1))]
TRIED = [w for k, w in enumerate(WIRINGS) if w in QUICK or k % 9 == 0]  # each order, and each sign with some


def simulate_six():
    truth = published.values("table7_estimates")
    return simulate(build("stage31"), truth, six_runs(), NoiseModel(SIGMAS), seed=3)


@pytest.fixture(scope="module")
def six():
    return simulate_six()


def found(log, **options):
    """What is said of a log: the texts of the claims, or that of a refusal."""
    try:
        return [claim.text for claim in fit(log, solver="direct", **options).claims]
    except InputError as error:
        return [str(error)]


# -- channels that are exchanged or inverted ---------------------------------------------------------------


@pytest.fixture(scope="module")
def unequal():
    """A log whose channels differ in noise, so that noise has to follow its channel."""
    sigma = {**SIGMAS, "hall_a_m": 0.3e-6, "hall_b_m": 0.6e-6, "hall_c_m": 1.2e-6}
    columns = record(seed=4, samples=20, sigma=sigma)
    return columns, sigma, fit(with_noise(columns, sigma), "stage31", solver="direct")


@pytest.mark.parametrize(
    ("order", "signs"),
    [pytest.param(*w, marks=() if w in QUICK else pytest.mark.slow, id=str(w)) for w in TRIED],
)
def test_every_wiring_is_noticed_and_put_right_by_its_corrections(unequal, order, signs):
    """The same optimum, errors and noise as with the right wiring; a single sign or exchange is named."""
    columns, sigma, right = unequal
    mixed, stated = dict(columns), dict(sigma)
    for k, (source, sign) in enumerate(zip(order, signs, strict=True)):
        mixed[HALL[k]] = sign * columns[HALL[source]]
        stated[HALL[k]] = sigma[HALL[source]]
    log = with_noise(mixed, stated)
    wiring = tuple((HALL[order.index(k)], signs[order.index(k)]) for k in range(3))
    corrections = [one.text for one in as_corrections(wiring, HALL)]
    if len(corrections) == 1 and "," not in corrections[0]:
        (said,) = found(log, model="stage31")
        assert corrections[0] in said
    elif corrections:
        try:
            result = fit(log, "stage31", solver="direct")
        except InputError:
            pass
        else:
            assert result.goodness.material
    result = fit(log, "stage31", solver="direct", corrections=corrections)
    same(right, result)
    assert result.solver.cost == pytest.approx(right.solver.cost, rel=1e-9)
    for row in ("rmse", "peak"):
        for name, value in right.error_rows["fitted"][row].items():
            assert result.error_rows["fitted"][row][name] == pytest.approx(value, rel=1e-6)
    assert result.assignment == (wiring if corrections else None)
    assert not result.claims


# -- where nothing is claimed ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seeds", "most"), [(range(6), 0), pytest.param(range(100, 200), 1, marks=pytest.mark.slow)]
)
def test_nothing_is_claimed_of_logs_without_a_mistake(seeds, most):
    """However near they are looked at; of many at most one in a hundred."""
    drawn = [recordings.machine("stage31", ("sound", seed), Size(12, 80, 4e-3)) for seed in seeds]
    assert sum(bool(mistakes_of(r.log, r.built) or found(r.log)) for r in drawn) <= most


@pytest.mark.parametrize("column", ["x_ref_m", "rz_ref_rad", "hall_b_m", "z_m", "ry_rad"])
@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_a_scale_that_gains_absorb_is_no_mistake(six, column, factor):
    assert found(with_noise(six | {column: factor * six[column]}), model="stage31") == []


# -- what is claimed ---------------------------------------------------------------------------------------


def test_a_reference_with_another_zero_in_a_run_or_in_each():
    rotary = recordings.machine("rotary", "zero", Size(6, 80, 5e-3))
    rotary.arrays["angle_ref_rad"][rotary.rows(2)] += 0.3
    (claim,) = fit(rotary.log, rotary.model, solver="direct").claims
    kind, column, size, *where = claim.correction.split()
    assert (kind, column, where) == ("zero_moved", "angle_ref_rad", ["in", "2"])
    assert float(size) == pytest.approx(0.3, rel=0.02)
    zeroed = mistaken("gap zeroed, log", "halbach", "3604.0").recording
    (claim,) = mistakes_of(zeroed.log, zeroed.built)
    assert (claim.name, claim.columns, claim.correction) == ("zero_moved", ("z_ref_m",), None)


def test_the_ends_of_some_runs_are_among_the_samples_that_are_tried():
    r = recordings.machine("homed", "ends", Size(40, 300, 1e-2))
    picked = claims.Trials(r.log, r.built, r.log.noise).log().array("t_s")
    ends = {r.arrays["t_s"][r.rows(run)][-1] for run in r.runs}
    assert len(picked) < len(r.arrays["t_s"]) / 2
    assert ends & {*picked}


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 0.9, 1.1, 1.9])
def test_a_gain_of_one_run_is_found_with_its_factor(six, factor):
    """Of a run as of the others; the readings that it multiplies stay, and their noise with them."""
    first = six["run"] == 0
    log = with_noise(six | {"hall_a_m": np.where(first, factor, 1.0) * six["hall_a_m"]})
    (claim,) = fit(log, "stage31", solver="direct").claims
    kind, column, number, _, runs = claim.correction.split()
    assert (kind in ("scale", "gain_step"), column, runs) == (True, "hall_a_m", "0")
    assert float(number) == pytest.approx(factor if kind == "gain_step" else 1 / factor, rel=1e-2)
    assert not fit(log, "stage31", solver="direct", corrections=[claim.correction]).claims


@pytest.mark.slow
def test_a_claim_that_is_accepted_is_a_note(six):
    here = six["run"] == 4
    wrong = with_noise(six | {"hall_a_m": np.where(here, -six["hall_a_m"], six["hall_a_m"])})
    (claim,) = fit(wrong, "stage31", solver="direct").claims
    assert (claim.name, claim.correction) == ("sign", "sign hall_a_m in 4")
    assert claim.explains > 0.9
    kept = fit(wrong, "stage31", solver="direct", accept=["sign"])
    assert kept.claims == ()
    assert claim.text in kept.notes
    other = fit(wrong, "stage31", solver="direct", accept=["delay"])
    assert other.claims == (claim,)
    assert claim.text not in fit(wrong, "stage31", solver="direct", accept=["all"]).notes


@pytest.mark.slow
def test_a_run_that_no_other_moves_like_is_not_thrown_away_with_its_like():
    """Runs of the paper's campaign move one axis each: a wrong one bends the gain of all that move alike."""
    columns = record(seed=1, samples=30)
    here = columns["run"] == 4
    wrong = with_noise(columns | {"x_ref_m": np.where(here, -columns["x_ref_m"], columns["x_ref_m"])})
    (claim,) = fit(wrong, "stage31", solver="direct").claims
    assert "sign x_ref_m in 4" in (claim.correction, *claim.rivals)
    assert claim.runs == (4,)


def test_a_number_between_decades_is_found_and_no_remedy_where_gains_make_up_for_it(six):
    log = with_noise(six | {"y_ref_m": six["y_ref_m"] / 3.7e-5})
    (claim,) = mistakes_of(log, build("stage31"))
    assert claim.correction is None
    assert all(text.startswith("scale y_ref_m ") for text in claim.rivals)
    factors = [float(text.split()[2]) for text in claim.rivals]
    assert 0.5 * 3.7e-5 < min(factors) < 3.7e-5 < max(factors) < 2 * 3.7e-5
    assert f"factors from {min(factors):.4g} to {max(factors):.4g} would do as well" in claim.text


def test_stuck_stretches_of_several_runs_are_left_out_and_the_first_is_named(six):
    """One begins where another run does not, so that no correction undoes both; each that is stated goes."""
    wrong, at = six["hall_a_m"].copy(), np.flatnonzero(six["run"] == 0)[0]
    other = np.flatnonzero(six["run"] == 3)[0]
    wrong[at + 40 : at + 90], wrong[other + 20 : other + 60] = wrong[at + 40], wrong[other + 20]
    log = with_noise(six | {"hall_a_m": wrong})
    (claim,) = fit(log, "stage31", solver="direct").claims
    assert claim.correction == "stuck hall_a_m 40 90 in 0"
    (claim,) = fit(log, "stage31", solver="direct", corrections=[claim.correction]).claims
    assert claim.correction == "stuck hall_a_m 20 60 in 3"


def test_what_is_late_is_not_taken_for_stuck_where_its_first_value_is_repeated(six):
    """A logger that starts late repeats the first value; the samples of each run show the delay."""
    wrong = six["hall_a_m"].copy()
    for run in np.unique(six["run"]):
        (here,) = np.nonzero(six["run"] == run)
        wrong[here] = six["hall_a_m"][np.maximum(here - 20, here[0])]
    claims = fit(with_noise(six | {"hall_a_m": wrong}), "stage31", solver="direct").claims
    assert claims[0].correction == "delay hall_a_m 20"


@pytest.mark.slow
def test_still_samples_in_a_log_without_columns_that_no_reading_follows_are_claimed(six):
    """What is at rest is filled in where the samples are looked at again, too."""
    wrong = six["hall_a_m"].copy()
    wrong[:60], wrong[500:540] = wrong[0], wrong[500]
    arrays = {c: v for c, v in six.items() if c not in VERTICAL_NOISE} | {"hall_a_m": wrong}
    claims = fit(with_noise(arrays), "stage30", solver="direct").claims
    assert any(one.name == "stuck" for one in claims)


@pytest.mark.slow
def test_a_delay_is_named_beside_noise_whose_colour_the_estimate_misses(six):
    """The runs that agree tell the floor: differences of neighbours show a tenth of such a noise."""
    rng, columns = np.random.default_rng(4), dict(simulate_six())
    for c in HALL:
        slow = lfilter([np.sqrt(1 - 0.95**2)], [1, -0.95], rng.standard_normal(len(columns["run"])))
        columns[c] = columns[c] + 2e-6 * slow
    here = np.flatnonzero(columns["run"] == 4)
    for c in ("x_ref_m", "y_ref_m", "rz_ref_rad"):
        columns[c] = np.r_[columns[c][: here[0]], np.roll(columns[c][here], 8), columns[c][here[-1] + 1 :]]
    log = Log.from_arrays(columns)
    (claim,) = mistakes_of(log, build("stage31"))
    assert claim.name == "delay"
    assert claim.runs == (4,)


# -- values that no machine has ----------------------------------------------------------------------------


def test_a_layout_that_nobody_stated_is_the_first_to_doubt():
    """Probes at 50 mm, fitted as the paper's at 200 mm; of the layout that the log states nothing is said."""
    places = ([0.05, 0.05], [-0.05, 0.05], [0.05, -0.05])
    senses = ([0, 1], [0, 1], [1, 0])
    near = [
        {"channel": c, "position_m": place, "senses": s}
        for c, place, s in zip(HALL, places, senses, strict=True)
    ]
    values = {n: v for n, v in published.values("table7_estimates").items() if not n.startswith("H")}
    model = build("stage31", meta=Meta(probes=near))
    log = with_noise(simulate(model, values, six_runs(), NoiseModel(SIGMAS), seed=3))
    first = fit(log, "stage31", solver="direct").claims[0]
    assert (first.name, first.correction) == ("layout", None)
    assert "is this the layout of your machine? State it with --machine FILE" in first.text
    assert fit(log, model, solver="direct").claims == ()


@pytest.mark.parametrize(
    ("mistake", "remedy"),
    [
        ("scale z_m 10", "scale z_m 0.1"),
        ("scale ry_rad 10", "scale ry_rad 0.1"),
        ("scale z_m 0.1", None),  # so that gains may follow ry_rad by a tenth: the axis is beside the probes
    ],
)
def test_gains_that_follow_tilt_as_on_no_rigid_stage_are_claimed(mistake, remedy):
    """Coefficients absorb these, so that the model describes the log: only what they mean shows them."""
    log = with_noise(record(seed=2, samples=30))
    assert fit(log, "stage31", solver="direct").claims == ()
    (claim,) = fit(corrected(log, [read_correction(mistake)]), "stage31", solver="direct").claims
    assert (claim.name, claim.columns) == ("gain_plane", ("z_m", "ry_rad"))
    assert claim.correction == remedy


@pytest.mark.parametrize(("by", "names"), [(1.5, []), (10.0, ["scale"])])
def test_an_ellipse_longer_than_any_encoder_makes_is_claimed_with_its_scale(by, names):
    turn = np.linspace(0, 4 * np.pi, 2000)
    rng = np.random.default_rng(0)
    v_sin, v_cos = np.sin(turn), np.cos(turn)
    columns = {"angle_ref_rad": turn, "v_sin_v": by * v_sin, "v_cos_v": v_cos}
    sigma = {"angle_ref_rad": 1e-5, "v_sin_v": 1e-4 * by, "v_cos_v": 1e-4}
    columns = {c: x + sigma[c] * rng.standard_normal(len(x)) for c, x in columns.items()}
    log = Log.from_arrays(columns, Noise.given(sigma, list(columns)))
    claims = fit(log, "rotary", solver="direct").claims
    assert [claim.name for claim in claims] == names
    for claim in claims:
        assert claim.correction == "scale v_sin_v 0.1"
        assert fit(log, "rotary", solver="direct", corrections=[claim.correction]).claims == ()


@pytest.mark.parametrize(
    "case",
    [
        "reading 20 samples off, run/stage31/3622.0",  # a third of the run
        "reference of 5 bits, run/chip/3622.0",  # a fifth of the values more than once
        "two references exchanged, run/halbach/3624.0",  # fields of a height that no float64 holds
    ],
)
def test_a_mistake_of_one_run_that_its_samples_hardly_show_is_named(case):
    wrong = mistaken(*case.rsplit("/", 2))
    (claim,) = mistakes_of(wrong.recording.log, wrong.recording.built)
    assert claim.correction in wrong.right


def test_of_scales_that_an_amplitude_makes_up_for_the_unit_is_named():
    wrong = mistaken("reading x 1000, log", "homed", "3625.0")
    (claim,) = mistakes_of(wrong.recording.log, wrong.recording.built)
    assert claim.correction == "scale v_sin_v mv"


def test_an_angle_in_volts_is_named_with_its_scale():
    rng, t = np.random.default_rng(0), np.arange(600) * 2e-3
    turn = 8.0 * t
    volts = 0.5 + 4.0 * (np.mod(turn + 0.01 * np.sin(turn), 2 * np.pi) / (2 * np.pi))
    columns = {"t_s": t, "angle_rad": volts + 1e-3 * rng.standard_normal(600), "angle_ref_rad": turn}
    (claim,) = mistakes_of(Log.from_arrays(columns), build("rotary", meta=Meta(columns=tuple(columns))))
    kind, column, factor = claim.correction.split()
    assert (kind, column) == ("scale", "angle_rad")
    assert float(factor) == pytest.approx(2 * np.pi / 4.0, rel=2e-3)


@pytest.mark.slow
def test_a_log_that_a_model_with_computed_columns_does_not_describe_is_looked_at_too():
    rng, t = np.random.default_rng(3), np.arange(300) * 1e-3
    runs = []
    for run, rate in enumerate((13.0, -13.0, 40.0, -40.0)):
        a = rate * t
        late = a + 3e-3 * np.cos(4 * a) - 60e-6 * rate  # four waves a turn, which a delay is none of
        v = [np.sin(late), np.cos(late)] + 3e-4 * rng.standard_normal((2, 300))
        runs.append(
            {"run": np.full(300, run), "t_s": t, "v_sin_v": v[0], "v_cos_v": v[1], "angle_ref_rad": a}
        )
    log = Log.from_arrays({c: np.concatenate([r[c] for r in runs]) for c in runs[0]})
    found = fit(log, "rotary", effects=["time_skew"])
    assert found.value("delay") == pytest.approx(60e-6, rel=0.1)
    assert found.goodness is not None
    assert found.goodness.sentence


# -- models without run statistics ---------------------------------------------------------------------------


def test_a_trial_beyond_numbers_does_not_end_the_search(monkeypatch):
    inverted = mistaken("sign of a reading, log", "planar", "5.0", Size(5, 24, 4e-3))
    (right,), r = inverted.right, inverted.recording
    beyond = [Correction("scale", ("z_ref_m",), (factor,)) for factor in (1e5, 1e200)]
    hypotheses = [*beyond, Correction("sign", (right.split()[1],))]
    monkeypatch.setattr(claims, "hypotheses", lambda *_: iter(hypotheses))
    assert [one.correction for one in mistakes_of(r.log, r.built)] == [right]


def test_what_is_tried_of_a_kind_does_not_depend_on_how_many_numbers_another_has():
    sign = Correction("sign", ("x_ref_m",))
    scales = {Correction("scale", ("x_ref_m",), (float(n),)): 0.1 for n in range(2, 40)}
    assert [sign] in list(claims._closest({sign: 0.5, **scales}))


@pytest.mark.slow
def test_trials_of_a_mover_end_where_newton_does(monkeypatch):
    """A wrong hypothesis may leave a tangent without an optimum, on which IPOPT stays for minutes."""
    monkeypatch.setattr(optimum.solvers, "ipopt", lambda *_, **__: pytest.fail("IPOPT was asked"))
    drawn = recordings.machine("planar", 3)
    arrays = drawn.arrays | {"x2_col_1_v": -drawn.arrays["x2_col_1_v"]}
    log = Log.from_arrays(
        arrays, Noise.given(drawn.stated, tuple(arrays)), Meta(base_model=drawn.model, probes=drawn.probes)
    )
    assert [c.correction for c in fit(log, drawn.built).claims] == ["sign x2_col_1_v"]


@pytest.mark.slow
def test_ends_of_runs_that_only_the_model_without_effects_misses_are_no_claim():
    """That model leaves five samples a wave in fast runs; the spikes at the ends are of its gap."""
    model = build("rotary", added=("time_skew", "third_harmonic_distortion"))
    speeds = [13, -13, 26, -26, 40, -40] * 2 + [160, -160] * 4
    runs = tuple(Run(1.0, {}, {"angle_rad": ramp(speed)}) for speed in speeds)
    values = {"Vx": 6e-3, "Vy": -9e-3, "Ay": 1.01, "beta": 0.012, "zero": 0.6, "delay": 60e-6}
    values |= {"third_harmonic_distortion_m3_re": 0.004}
    noise = NoiseModel({"v_sin_v": 3.5e-4, "v_cos_v": 3.5e-4, "angle_ref_rad": 2e-5})
    columns = simulate(model, values, Campaign(2e-3, runs), noise, seed=8)
    result = fit(Log.from_arrays(columns), model, solver="direct")
    assert not [*result.claims, *(note for note in result.notes if "isolated spikes" in note)]


def test_a_reading_whose_axis_is_at_rest_is_not_of_another_recording():
    """One run along x; the Hall of y has hum only. A reference of another motion is claimed all the same."""
    model = build("stage31")
    run = Run(2.0, {}, {"x_m": sine(3e-4, 1.0)})
    noise = NoiseModel(dict.fromkeys((*model.channels, *model.references), 1e-7))
    columns = simulate(model, {}, Campaign(2e-3, (run,)), noise, seed=3)
    columns["hall_b_m"] += 2e-6 * np.sin(2 * np.pi * 7 * columns["t_s"])
    assert "unrelated" not in names_of(Log.from_arrays(columns), model)
    columns["x_ref_m"] = np.random.default_rng(0).permutation(columns["x_ref_m"])
    assert "unrelated" in names_of(Log.from_arrays(columns), model)


def names_of(log, model):
    return [claim.name for claim in fit(log, model, solver="direct").claims]
