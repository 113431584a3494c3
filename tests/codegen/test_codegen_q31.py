"""The integer decoupler: against the model in double, and exponents that outlast a calibration.

Independent facts: the model's decoded pose; parameters drawn within half
of their bounds; the layout number is that of names, exponents and lines: the same number is the same code.
"""

import json

import pytest
from calibrations import fit_of, made
from firmware import calibration

from hallsym.codegen import generate
from hallsym.errors import InputError

LINEAR = ("stage31", "four probes", "user's height_quadratic", "vertical_offset_coupling")


@pytest.mark.parametrize("case", LINEAR)
def test_a_tenth_of_a_nanometre_is_added_at_most(case):
    met = made(case, arithmetic="q31").backend.errors(20_000, seed=4)
    assert max(met["x_m"], met["y_m"]) <= 0.1e-9
    assert met["rz_rad"] <= 3e-9


@pytest.mark.parametrize("z", [(-1e-3, 1e-3), (-2e-4, 3e-3)])
def test_gains_that_vary_much_take_more_newton_steps_and_stay_within_their_bound(z):
    source = generate(calibration(), arithmetic="q31", ranges={"z_m": z}).backend
    for column, error in source.errors(20_000, seed=1).items():
        assert error <= source.program.bounds[column][2] < 1e-8
    assert len(source.program.lines) > len(made("stage31", arithmetic="q31").backend.program.lines)


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
    model = fit_of(case).model
    assert len({found[c] for c in model.channels}) == 1
    assert found["rx_rad"] == found["ry_rad"]
    assert found["x_m"] == found["y_m"]
    for c in model.channels:  # and no bit of the largest is given up
        reach = max(abs(v) for v in made(case, arithmetic="q31").decoupler.ends(c))
        assert 2**25 <= reach * 2.0 ** found[c] <= 2**30
