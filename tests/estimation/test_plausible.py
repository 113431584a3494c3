"""Units, signs, order and runs: silent where a log is what it says, and where it cannot tell.

What is said of each mistake stands in the table of `tests/log`.
"""

import numpy as np
import pytest
from twins import HALL, record, with_noise

import hallsym
from hallsym.errors import InputError
from hallsym.estimation import fit
from hallsym.families import build, published
from hallsym.log import Log, Meta, Noise, Sigma
from hallsym.simulation import Campaign, NoiseModel, Run, paper_campaign, simulate
from hallsym.simulation.paper import VERTICAL_NOISE
from hallsym.simulation.signals import multi_sine

SIGMA = dict.fromkeys(HALL, 5e-7) | {"x_ref_m": 1e-6, "y_ref_m": 1.4e-6, "rz_ref_rad": 5e-7} | VERTICAL_NOISE


def log_of(arrays):
    return Log.from_arrays(arrays, Noise({c: Sigma(s, "given") for c, s in SIGMA.items()}))


def six_runs():
    settings = published.table("table6_settings")
    motion = {
        "x_m": multi_sine(300e-6, [1.0, 4.0]),
        "y_m": multi_sine(500e-6, [2.0, 5.0]),
        "rz_rad": multi_sine(300e-6, [3.0, 7.0]),
    }
    at = [{axis: settings[axis][k] for axis in ("z_m", "rx_rad", "ry_rad")} for k in (0, 4, 8, 12, 15, 18)]
    return Campaign(2e-3, tuple(Run(1.0, setting, motion) for setting in at))


def machine(rng, model):
    """A machine anywhere inside the bounds; a rigid stage, as wherever Z and tilts are measured."""
    values = {p.name: rng.uniform(p.lower, p.upper) for p in model.parameters}
    x0, y0 = rng.uniform(-0.3, 0.3, 2)
    for k, (label, side) in enumerate((("A", 1), ("B", -1), ("C", 1)), start=1):
        slope = -rng.uniform(50, 400)
        values[f"a_{label}"] = slope
        values[f"b_{label}"] = slope * (values[f"H{k}y"] - y0)
        values[f"c_{label}"] = -slope * (side * values[f"H{k}x"] - x0)
    return values


def noted(seeds):
    """Seeds of simulated logs without a mistake of which something is said."""
    model, out = build("stage31"), []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        campaign = paper_campaign() if seed % 2 else six_runs()
        log = log_of(simulate(model, machine(rng, model), campaign, NoiseModel(SIGMA), seed=seed))
        try:
            said = [note for note in fit(log, model, solver="direct").notes if "beyond" not in note]
        except InputError as error:
            said = [str(error)]
        out += [(seed, said)] if said else []
    return out


def test_logs_without_a_mistake_pass_silently():
    assert noted(range(6)) == []


@pytest.mark.slow
def test_at_most_one_per_cent_of_logs_without_a_mistake_get_a_note():
    assert len(noted(range(100, 300))) <= 2


@pytest.fixture(scope="module")
def six():
    truth = published.values("table7_estimates")
    return simulate(build("stage31"), truth, six_runs(), NoiseModel(SIGMA), seed=3)


@pytest.mark.parametrize("column", ["x_ref_m", "rz_ref_rad", "hall_b_m", "z_m", "ry_rad"])
@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_a_plausible_scale_is_no_unit(six, column, factor):
    assert fit(log_of(six | {column: factor * six[column]}), "stage31", solver="direct").notes == ()


def test_gains_that_do_not_follow_tilts_are_a_legal_machine():
    """And so are probes 10 mm from the origin, or gains that do not follow the height."""
    near = [
        {"channel": c, "position_m": place, "senses": senses}
        for c, place, senses in zip(
            HALL, ([0.01, 0.01], [-0.01, 0.01], [0.01, -0.01]), ([0, 1], [0, 1], [1, 0]), strict=True
        )
    ]
    paper = published.values("table7_estimates")
    flat = {n: 0.0 if n[:2] in ("b_", "c_") else v for n, v in paper.items()}
    inner = {n: v for n, v in flat.items() if not n.startswith("H")}
    level = {n: 0.0 if n.startswith("a_") else v for n, v in flat.items()}
    for model, truth in (
        (build("stage31"), flat),
        (build("stage31"), level),
        (build("stage31", meta=Meta(probes=near)), inner),
    ):
        log = log_of(simulate(model, truth, six_runs(), NoiseModel(SIGMA), seed=3))
        assert fit(log, model, solver="direct").notes == ()


def test_two_explanations_are_both_named_and_the_other_is_a_note_where_one_is_taken(six):
    wrong = log_of(six | {c: -six[c] for c in HALL})
    with pytest.raises(InputError, match=r"hall_a_m.* inverted; or the sign of x_ref_m, y_ref_m and rz"):
        fit(wrong, "stage31", solver="direct")
    found = fit(wrong, "stage31", solver="direct", resolve_wiring=True)
    assert found.wiring == tuple((c, -1) for c in HALL)
    assert any("the sign of x_ref_m, y_ref_m and rz_ref_rad looks inverted" in note for note in found.notes)


@pytest.mark.parametrize(("factor", "refused"), [(0.5, True), (0.57, False), (1.7, False), (1.9, True)])
def test_a_gain_of_one_run_is_that_of_another_machine_beyond_a_factor(six, factor, refused):
    """From .53 to 1.8 an effect may make it, and the fit says where it does not describe the log."""
    first = six["run"] == 0
    log = log_of(six | {"hall_a_m": np.where(first, factor, 1.0) * six["hall_a_m"]})
    if refused:
        with pytest.raises(InputError, match=r"In run 0 .* hall_a_m changes by .* where 0.873 is usual"):
            fit(log, "stage31", solver="direct")
    else:
        found = fit(log, "stage31", solver="direct").goodness
        assert (found.material, found.worst_run, found.worst_channel) == (True, 0, "hall_a_m")


def test_a_held_out_run_is_a_note(six):
    here = six["run"] == 4
    wrong = log_of(six | {"hall_a_m": np.where(here, -six["hall_a_m"], six["hall_a_m"])})
    with pytest.raises(InputError, match=r"In run 4 .*--holdout 4"):
        fit(wrong, "stage31", solver="direct")
    notes = fit(wrong, "stage31", solver="direct", holdout=(4,)).notes
    assert any("In run 4 " in note and "before judging" in note for note in notes)


def test_spikes_do_not_look_like_another_run():
    columns = record(seed=7, samples=100)
    rng = np.random.default_rng(0)
    for c in HALL:
        columns[c] = columns[c] + np.where(rng.random(len(columns[c])) < 0.01, 2e-3, 0.0)
    notes = fit(with_noise(columns), "stage31", solver="direct").notes
    assert any("isolated spikes" in note for note in notes)
    assert not any("run" in note.split(" of ")[0].lower() for note in notes if "spikes" not in note)


def test_units_of_a_column_file_count(tmp_path, six):
    """A column that says um and holds m is a million times too small, and m is what it looks like."""
    path = tmp_path / "log.csv"
    named = {("x_ref_um" if c == "x_ref_m" else c): v for c, v in six.items()}
    rows = np.column_stack(list(named.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(named), comments="", fmt="%.9g")
    with pytest.raises(InputError, match=r"x_ref_m looks like m .*--column x_ref_m=x_ref_um"):
        hallsym.fit(hallsym.read_log(path), "stage31", solver="direct")
