"""Plans for models whose readings are no polynomials of the pose: magnet arrays, and a lag."""

import numpy as np
import pytest

from hallsym.estimation import fit
from hallsym.estimation.likelihood import cost_near
from hallsym.experiment import Ranges, plan
from hallsym.families import build
from hallsym.log import Log, Noise
from hallsym.model import Model
from hallsym.simulation import NoiseModel, simulate

BOX = dict.fromkeys(("x_m", "y_m"), (-0.014, 0.014)) | {f"r{a}_rad": (-0.01, 0.01) for a in "xyz"}
BOX |= {"z_m": (0.004, 0.01)}
MODELS = [
    pytest.param("halbach", (), 0.01, id="waves"),
    pytest.param("halbach", ("first_order_lag",), 0.01, id="waves and what the motion was before"),
    pytest.param("halbach", ("magnet_map",), 0.01, id="each magnet"),
    pytest.param("halbach_planar", (), 0.02, id="six coordinates", marks=pytest.mark.slow),
]


def noise_of_all(model: Model) -> dict[str, float]:
    """1 sigma of every reading and reference."""
    references = {c: 5e-6 if c.endswith("_rad") else 1e-6 for c in model.references}
    return dict.fromkeys(model.channels, 1e-4) | references


@pytest.mark.parametrize(("name", "effects", "step_s"), MODELS)
def test_the_planned_runs_tell_what_the_plan_says_and_a_fit_finds_the_truth(
    name: str, effects: tuple[str, ...], step_s: float
) -> None:
    model = build(name, added=effects)
    assert model.family.example is not None
    values = {k: v for k, v in model.family.example.values.items() if k in model.names}
    box = {axis: BOX[axis] for axis in model.pose}
    ranges = Ranges(box, (1.0, 2.0), 1.0, step_s, levels=2, runs=6, noise=noise_of_all(model))
    planned = plan(ranges, model, values)
    columns = simulate(model, values, planned.campaign, NoiseModel(ranges.noise), seed=1)
    log = Log.from_arrays(columns, Noise.given(ranges.noise, tuple(columns)))
    told = cost_near(log, model, model.vector(values), ranges.noise).information(model.vector(values))
    for gauge in model.gauges:  # as if the mean of its parameters were known to 1e-8
        mean = np.isin(model.names, gauge.parameters) / len(gauge.parameters)
        told = told + 1e16 * np.outer(mean, mean)
    assert planned.std == pytest.approx(np.sqrt(np.diag(np.linalg.inv(told))), rel=0.01)
    assert np.all(planned.position > 0)
    found = fit(log, model)
    assert np.all(np.abs(found.values - model.vector(values)) < 5 * found.std)
