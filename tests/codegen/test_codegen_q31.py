"""The integer decoupler: against the model in double, and exponents that outlast a calibration.

Independent facts: the model's decoded pose; parameters drawn within half
of their bounds; the layout number is that of names, exponents and lines: the same number is the same code.
"""

import json

import numpy as np
import pytest
from firmware import CASES, calibration, made
from twins import with_arrays

from hallsym.codegen import generate
from hallsym.codegen.box import box_of
from hallsym.codegen.integer_backend import IntegerBackend
from hallsym.codegen.integer_c import integer_program
from hallsym.codegen.lowering import lower
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
