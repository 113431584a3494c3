"""Exponents of the integers outlast a calibration: `--params-only` takes what the same machine may become.

Independent facts: parameters drawn within half of their bounds; the
layout number is that of names, exponents and lines, so the same number is the same code.
"""

import json

import numpy as np
import pytest
from firmware import CASES, calibration, made, need, ran
from test_codegen_correction import fit_of
from twins import with_arrays

from hallsym.cli.main import main
from hallsym.codegen import generate
from hallsym.codegen.box import box_of
from hallsym.codegen.integer_backend import IntegerBackend
from hallsym.codegen.integer_c import integer_program
from hallsym.codegen.lowering import lower
from hallsym.errors import InputError
from hallsym.log import Noise, Sigma


def drawn(fit, reach, count, seed=0):
    """Calibrations whose parameters are within `reach` (n,) of those of a fit, and within their bounds."""
    lower_bound, upper_bound = fit.model.bounds
    share = np.random.default_rng(seed).uniform(-1, 1, (count, len(reach)))
    for row in fit.values + share * reach:
        yield with_arrays(fit, values=np.clip(row, lower_bound, upper_bound))


def half_of_geometry(fit):
    """Half of the bounds of positions, tilts and gains; field terms as much again as they are."""
    lower_bound, upper_bound = fit.model.bounds
    field = np.array([name[:2] in ("a_", "b_", "c_") for name in fit.model.names])
    return np.where(field, np.abs(fit.values), (upper_bound - lower_bound) / 4)


def backend_of(fit, plan):
    found = lower(fit, box_of(fit))
    return IntegerBackend(found, {}, integer_program(found, plan))


def test_plausible_recalibrations_have_the_same_code():
    first = made("stage31", arithmetic="q31").backend
    for fit in drawn(calibration(), half_of_geometry(calibration()), 25):
        again = backend_of(fit, first.program.plan)
        assert again.layout == first.layout
        for column, error in again.errors(1000).items():
            assert error <= again.program.bounds[column][2]
            assert error <= 1e-9


@pytest.mark.parametrize(
    "case",
    [*(pytest.param(c, marks=pytest.mark.slow) for c in ("meng angle", "meng volts")), "ellipse volts"],
)
def test_an_encoder_that_moved_a_little_has_the_same_code(case, tmp_path):
    fit = fit_of(case)
    first = generate(fit, arithmetic="q31")
    first.write(tmp_path / "fw")
    lower_bound, upper_bound = fit.model.bounds
    reach = 0.01 * np.minimum(upper_bound - lower_bound, 2.0)
    for again in drawn(fit, reach, 4):
        now = generate(again, arithmetic="q31", like=tmp_path / "fw")
        assert now.backend.layout == first.backend.layout
        code, before = (some.files["decoupler.c"].split("\n", 2)[2] for some in (now, first))
        assert code == before  # but for the calibration that its second line names


def test_the_command_recalibrates_by_the_plan_of_the_folder(tmp_path, capsys):
    need("gcc", "make")
    folder, fit = tmp_path / "fw", calibration()
    fit.save(tmp_path / "calib.json")
    base = ["codegen", str(tmp_path / "calib.json"), "-o", str(folder), "--arithmetic", "q31"]
    assert main(base) == 0
    source = (folder / "decoupler.c").read_bytes()
    gains = np.array([name.startswith("eta_") for name in fit.model.names])
    noise = Noise({c: Sigma(s.value, "given") for c, s in fit.noise.sigmas.items()})
    moved = with_arrays(fit, values=np.where(gains, 0.97 * fit.values, fit.values * 1.3)).changed(noise=noise)
    lower_bound, upper_bound = fit.model.bounds
    moved = with_arrays(moved, values=np.clip(moved.values, lower_bound, upper_bound))
    moved.save(tmp_path / "calib.json")
    # a folder of its own would get other exponents
    assert (
        generate(moved, arithmetic="q31").backend.layout != made("stage31", arithmetic="q31").backend.layout
    )
    assert main([*base, "--params-only"]) == 0
    assert (folder / "decoupler.c").read_bytes() == source
    assert "as stated" in ran(folder, "make", "check")
    far = with_arrays(
        fit, values=np.where([n[:2] == "a_" for n in fit.model.names], 6 * fit.values, fit.values)
    )
    far.save(tmp_path / "calib.json")
    assert main([*base, "--params-only"]) == 2
    said = capsys.readouterr().err
    assert "gain_hall_a_z does not fit the exponents of the code in the folder" in said
    assert len(said) < 310


@pytest.mark.parametrize("edited", [[1000] * 71, ["a"], {"a": 1}, [29] * 71, [29]])
def test_an_edited_plan_is_no_plan(tmp_path, edited):
    folder = tmp_path / "fw"
    made("stage31", arithmetic="q31").write(folder)
    path = folder / "table/decoupler_params.json"
    record = json.loads(path.read_text())
    record["options"]["plan"] = edited
    path.write_text(json.dumps(record))
    with pytest.raises(InputError):
        generate(calibration(), arithmetic="q31", like=folder).write(folder, params_only=True)


@pytest.mark.parametrize("case", ["stage31", "four probes", "user's height_quadratic"])
def test_equal_inputs_have_one_exponent(case):
    found = made(case, arithmetic="q31").backend.exponents
    model = CASES[case]().model
    assert len({found[c] for c in model.channels}) == 1
    assert found["rx_rad"] == found["ry_rad"]
    assert found["x_m"] == found["y_m"]
    for c in model.channels:  # and no bit of the largest is given up
        reach = max(abs(v) for v in made(case, arithmetic="q31").decoupler.ends(c))
        assert 2**25 <= reach * 2.0 ** found[c] <= 2**30


@pytest.mark.parametrize("options", [["--arithmetic", "q31"], ["--double"]])
def test_a_recalibration_takes_the_numbers_of_the_folder(options, tmp_path):
    calibration().save(tmp_path / "calib.json")
    base = ["codegen", str(tmp_path / "calib.json"), "-o", str(tmp_path / "fw")]
    assert main([*base, *options]) == 0
    before = (tmp_path / "fw/table/decoupler_params.bin").read_bytes()
    assert main([*base, "--params-only"]) == 0
    assert (tmp_path / "fw/table/decoupler_params.bin").read_bytes() == before
