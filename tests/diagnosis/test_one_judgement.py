"""`fit`, `evaluate` and `diagnose` say the same of one log, whatever is known of its noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from beside import REAL, needs
from gap_twins import machine
from twins import swept, white

from hallsym import Fit, evaluate, fit, read_log
from hallsym.diagnosis import Diagnosis, diagnose
from hallsym.families.halbach.layout import columns
from hallsym.families.halbach.models import FAMILY, halbach
from hallsym.log import Log, Noise, as_log

ROOT = Path(__file__).parents[2]
QUIET = {"seed": 3, "thin": 6, "pink": 0.0, "curvature": 0.0, "noise": "white"}


def judged(log: Log, model: str) -> tuple[Fit, Diagnosis]:
    """Ask all of one log, of which nobody may contradict another."""
    found, d = fit(log, model, solver="direct", accept=["all"]), diagnose(log, model)
    known = evaluate(found, log).goodness
    assert known.material is found.goodness.material
    # noise that is estimated is that of the residual on the way in a fit, and at its end in an evaluation
    assert known.limit == pytest.approx(found.goodness.limit, rel=1e-6 if known.uncertain == 1 else 1e-4)
    if found.goodness.material or d.metric.before > 1.1 * found.goodness.limit * d.metric.floor:
        assert found.goodness.material
        assert d.verdict != "no gap"
    return found, d


@pytest.mark.slow
@pytest.mark.parametrize("unstated", [(), ("z_m", "rx_rad", "ry_rad")])
def test_noise_that_adds_nothing_to_the_error_need_not_be_stated(unstated: tuple[str, ...]) -> None:
    log = machine("multisine", **QUIET)
    for factor in (1.0, 1.12, 2.5):
        stated = {c: replace(s, value=s.value / factor) for c, s in log.noise.sigmas.items()}
        known = Noise({c: s for c, s in stated.items() if c not in unstated})
        found, d = judged(replace(log, noise=known), "stage31")
        assert d.verdict == ("no gap" if factor == 1 else "noise larger than stated")
        assert found.goodness.material is (factor > 1)
        said = found.goodness.sentence or ""
        assert said.startswith("The noise is larger than stated") is (factor > 1), said
        assert found.goodness.noise == pytest.approx(factor if factor > 1 else 0.0, rel=0.05)
        assert found.goodness.uncertain < 1.001


@pytest.mark.parametrize(("name", "model"), [("campaign", "stage31"), ("encoder", "rotary_meng")])
def test_bundled_logs_are_judged_alike(name: str, model: str) -> None:
    found, d = judged(read_log(ROOT / "data" / name), model)
    assert (d.verdict, found.goodness.material) == ("no gap", False)


@pytest.mark.slow
@pytest.mark.parametrize(("run", "lies"), [(22, "11 holdout"), (8, "46 fitted")])
def test_one_bad_run_is_a_gap_until_it_is_corrected(run: int, lies: str) -> None:
    data = white(5)
    data["hall_c_m"][data["run"] == run] *= 1.05  # within the limit of an unstated floor, all runs together
    bad, undo = Log.from_arrays(data), f"gain_step hall_c_m 1.05 in {run}"
    d = diagnose(bad, "stage31")
    assert d.verdict == "unexplained"
    assert f"worst in run {run}, channel hall_c_m" in d.sentence
    assert any(s.text.endswith(f"lies in run {run}, one of {lies} runs") for s in d.where)
    assert diagnose(bad, "stage31", corrections=undo).verdict == "no gap"
    found = fit(bad, "stage31", solver="direct", corrections=[undo])
    assert evaluate(found, bad).goodness.material
    assert not evaluate(found, bad, corrections=undo).goodness.material


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 3.0])
def test_waves_of_any_number_are_not_the_noise_of_a_table(size: float) -> None:
    """200 knots a turn, noise of .014 degrees, waves of 4, 50 and 100 periods a turn."""
    ref, sigma = np.arange(200) * 2 * np.pi / 200, np.radians(0.014)
    noise = np.random.default_rng(1).standard_normal(200)
    error = sigma * (noise + size * sum(np.cos(n * ref + n) for n in (4, 50, 100)))
    log = as_log({"angle_rad": (ref + error) % (2 * np.pi), "angle_ref_rad": ref})
    found, _ = judged(log, "rotary")
    assert found.noise_floor["angle_rad"] == pytest.approx(sigma, rel=0.2)
    assert found.goodness.material is (size > 0)


@pytest.mark.slow
@needs(REAL)
@pytest.mark.parametrize("folder", ["rotary-mechaduino-luts", "maker-tables", "linear-hall-undulators"])
def test_recordings_whose_error_repeats_are_never_without_a_gap(folder: str) -> None:
    columns = {
        "rotary-mechaduino-luts": {"angle_count": "raw_count", "angle_ref_deg": "ref_angle_deg"},
        "linear-hall-undulators": {"angle_ref_deg": "ref_deg"},
    }.get(folder)
    counts = 16384 if folder.startswith("rotary") else None
    for file in sorted((REAL / folder).glob("*.csv"))[::4]:
        found, d = judged(read_log(file, columns=columns, counts_per_turn=counts), "rotary")
        assert found.goodness.material, file.name
        assert d.verdict in ("explained", "unexplained"), file.name


@pytest.mark.slow
def test_the_floor_is_that_of_the_runs_that_judge() -> None:
    """Noise moves the pose of a magnet array by more at a wider gap than that of the fitted runs."""
    gaps = (0.0042, 0.0052, 0.0072, 0.0042, 0.0052, 0.0046)
    model = halbach(columns([(j - 4) * 0.01 for j in range(9)]))
    moves = [(4.0, 0.02, 0.9 + 0.1 * k, 2e-4, 2.3, gap) for k, gap in enumerate(gaps)]
    log = swept(model, FAMILY.example.values, moves, 2e-3, 2e-6)
    d = diagnose(log, model, holdout=[2])
    assert d.verdict == "no gap"
    assert d.metric.before == pytest.approx(d.metric.floor, rel=0.08)
    sizes = d.size.outputs["z_m"]
    assert sizes["held_out"].noise > 1.3 * sizes["fitted"].noise
