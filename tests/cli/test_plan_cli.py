"""`hallsym plan`: from a ranges file to a campaign that runs; ranges that cannot be; pictures."""

import json

import numpy as np
import pytest
from test_refused import RANGES

from hallsym.experiment import read_ranges
from hallsym.simulation import read_campaign


@pytest.fixture
def ranges(tmp_path):
    def write(text: str = RANGES):
        (tmp_path / "ranges.toml").write_text(text, encoding="utf-8")
        return tmp_path / "ranges.toml"

    return write


def test_a_plan_is_written_simulated_fitted_and_continued(run, ranges, tmp_path):
    campaign, log = tmp_path / "next.toml", tmp_path / "log.csv"
    pictures = ("--plots", tmp_path / "pictures")
    code, out, err = run("plan", ranges(), "-o", campaign, *pictures)
    assert (code, err) == (0, "")
    assert "8 runs of 1 s" in out
    assert (tmp_path / "pictures" / "coverage.png").read_bytes()[:4] == b"\x89PNG"
    planned = read_campaign(campaign)
    assert len(planned.runs) == 8
    assert all(run.name in campaign.read_text() for run in planned.runs)
    assert run("simulate", campaign, "-o", log, "--seed", 1)[0] == 0
    assert run("fit", log, "--solver", "direct")[0] == 0
    code, out, _ = run("plan", ranges(), "--after", log, "--runs", 2, "--criterion", "max-u", "--json")
    record = json.loads(out)
    assert code == 0
    assert (record["recorded_runs"], record["criterion"]) == (8, "max-u")
    assert sum(entry["count"] for entry in record["chosen"]) == record["runs"] == 2
    assert record["worst"]["std"] <= record["worst_before"]["std"]
    assert any("log.csv" in note for note in record["notes"])


def test_another_machine_states_its_noise(run, ranges, tmp_path):
    machine = tmp_path / "machine.toml"
    probes = [("a", 0.2, 0.4, [0, 1]), ("b", -0.2, 0.4, [0, 1]), ("c", 0.1, 0.3, [1, 0])]
    machine.write_text(
        "".join(
            f'[[probes]]\nchannel = "hall_{k}_m"\nposition_m = [{x}, {y}]\nsenses = {n}\n'
            for k, x, y, n in probes
        )
    )
    code, _, err = run("plan", ranges(), "--machine", machine)
    assert code == 2
    assert "[noise]" in err
    noise = "[noise]\nhall_m = 5e-7\nx_ref_um = 0.5\ny_ref_um = 0.5\nrz_ref_urad = 0.5\n"
    assert run("plan", ranges(RANGES + noise), "--machine", machine, "--json")[0] == 0


def test_units_and_defaults_of_a_ranges_file(ranges):
    found = read_ranges(ranges())
    assert found.box["ry_rad"] == (-5e-4, 5e-4)
    assert np.isclose(found.box["x_m"], (-300e-6, 300e-6), rtol=1e-12).all()
    assert (found.levels, found.minutes, found.reset_s) == (2, None, None)
    zoned = read_ranges(
        ranges(RANGES + "[[exclude]]\nz_um = [0, 250]\nrx_urad = [0, 500]\n[reference]\nx_nm = 50\n")
    )
    assert zoned.excluded[0]["z_m"] == (0.0, 250e-6)
    assert zoned.reference["x_m"] == pytest.approx(50e-9)
