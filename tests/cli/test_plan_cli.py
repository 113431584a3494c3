"""`hallsym plan`: from a ranges file to a campaign that runs; ranges that cannot be; pictures."""

import json

import numpy as np
import pytest

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.experiment import read_ranges
from hallsym.simulation import read_campaign

RANGES = """
step_s = 0.02
seconds_per_run = 1.0
frequencies_hz = [1.0, 2.0, 3.0]
runs = 8
levels = 2
trajectories = ["combined"]

[range]
x_um = [-300, 300]
y_um = [-500, 500]
rz_urad = [-300, 300]
z_um = [-250, 250]
rx_urad = [-500, 500]
ry_mrad = [-0.5, 0.5]
"""


@pytest.fixture
def ranges(tmp_path):
    def write(text: str = RANGES):
        (tmp_path / "ranges.toml").write_text(text, encoding="utf-8")
        return tmp_path / "ranges.toml"

    return write


def run(capsys, *arguments) -> tuple[int, str, str]:
    code = main([str(a) for a in arguments])
    return code, *capsys.readouterr()


def test_a_plan_is_written_simulated_fitted_and_continued(capsys, ranges, tmp_path):
    campaign, log = tmp_path / "next.toml", tmp_path / "log.csv"
    pictures = ("--plots", tmp_path / "pictures")
    code, out, err = run(capsys, "plan", ranges(), "-o", campaign, *pictures)
    assert (code, err) == (0, "")
    assert "8 runs of 1 s" in out
    assert (tmp_path / "pictures" / "coverage.png").read_bytes()[:4] == b"\x89PNG"
    planned = read_campaign(campaign)
    assert len(planned.runs) == 8
    assert all(run.name in campaign.read_text() for run in planned.runs)
    assert run(capsys, "simulate", campaign, "-o", log, "--seed", 1)[0] == 0
    assert run(capsys, "fit", log, "--solver", "direct")[0] == 0
    code, out, _ = run(capsys, "plan", ranges(), "--after", log, "--runs", 2, "--json")
    record = json.loads(out)
    assert code == 0
    assert record["recorded_runs"] == 8
    assert record["runs"] == 2
    assert record["worst"]["std"] < record["worst_before"]["std"]
    assert any("log.csv" in note for note in record["notes"])


def test_json_holds_the_numbers_of_the_table(capsys, ranges):
    code, out, _ = run(capsys, "plan", ranges(), "--json", "--criterion", "max-u")
    record = json.loads(out)
    assert code == 0
    assert sum(entry["count"] for entry in record["chosen"]) == record["runs"] == 8


def test_another_machine_states_its_noise(capsys, ranges, tmp_path):
    machine = tmp_path / "machine.toml"
    probes = [("a", 0.2, 0.4, [0, 1]), ("b", -0.2, 0.4, [0, 1]), ("c", 0.1, 0.3, [1, 0])]
    machine.write_text(
        "".join(
            f'[[probes]]\nchannel = "hall_{k}_m"\nposition_m = [{x}, {y}]\nsenses = {n}\n'
            for k, x, y, n in probes
        )
    )
    code, _, err = run(capsys, "plan", ranges(), "--machine", machine)
    assert code == 2
    assert "[noise]" in err
    noise = "[noise]\nhall_m = 5e-7\nx_ref_um = 0.5\ny_ref_um = 0.5\nrz_ref_urad = 0.5\n"
    assert run(capsys, "plan", ranges(RANGES + noise), "--machine", machine, "--json")[0] == 0


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


BAD = {
    "unknown key": (RANGES.replace("levels", "levls"), "did you mean 'levels'"),
    "no range": (RANGES[: RANGES.index("[range]")], "'range' is missing"),
    "axis without unit": (RANGES.replace("rx_urad", "rx"), "'rx' of .* must end with a unit of 'rx'"),
    "inverted": (RANGES.replace("z_um = [-250, 250]", "z_um = [250, -250]"), "must be .lowest, highest"),
    "twice": (RANGES + "z_m = [0, 1e-4]\n", "twice"),
    "one level": (RANGES.replace("levels = 2", "levels = 1"), "levels"),
    "unknown trajectory": (RANGES.replace('"combined"', '"combine"'), "did you mean 'combined'"),
    "trajectory as text": (RANGES.replace('["combined"]', '"combined"'), "list"),
    "negative noise": (RANGES + "[noise]\nhall_m = -1e-7\n", "hall_m"),
    "empty zone": (RANGES + "[[exclude]]\n", "empty"),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_ranges_are_refused_in_one_sentence(ranges, what):
    text, said = BAD[what]
    assert text != RANGES
    with pytest.raises(InputError, match=said) as caught:
        read_ranges(ranges(text))
    assert "\n" not in str(caught.value)


REFUSED = {
    "no motion": (RANGES.replace("[-300, 300]", "[0, 0]").replace("[-500, 500]", "[0, 0]"), (), "x, y or Rz"),
    "reference of a vertical axis": (RANGES + "[reference]\nz_um = 1\n", (), "[reference] z_m"),
    "axis of another sensor": (RANGES + "angle_deg = [0, 90]\n", (), "angle_rad, which stage31 has not"),
    "all excluded": (RANGES + "[[exclude]]\nz_um = [-300, 300]\n", (), "No admissible setting"),
    "too few runs": (RANGES, ("--runs", 2), "at least 4"),
    "no time": ("reset_s = 1\n" + RANGES, ("--minutes", 0.01), "too short for one run"),
    "both": (RANGES, ("--like-paper",), "either"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_plan_that_cannot_be_is_one_sentence_and_exit_code_2(capsys, ranges, tmp_path, what):
    text, options, said = REFUSED[what]
    code, out, err = run(capsys, "plan", ranges(text), "-o", tmp_path / "out.toml", *options)
    assert code == 2
    assert out == ""
    assert err.startswith("hallsym: ")
    assert err.count("\n") == 1
    assert said in err
    assert not (tmp_path / "out.toml").exists()
