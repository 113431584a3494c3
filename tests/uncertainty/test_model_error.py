"""The error of the model in the budget of a position, as a diagnosis hands it over.

Facts used: an error that is known and not corrected counts in full; two models of equal probability whose
positions differ by d scatter by d / 2; independent sources add in squares.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hallsym
from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.estimation import Fit
from hallsym.families import adapted
from hallsym.uncertainty import (
    Settings,
    over_log,
    position_budget,
    position_monte_carlo,
    read_model_error,
    uncertainty_map,
)
from hallsym.uncertainty.inputs import Candidate, ModelError, Shape

CHANNELS = ("hall_a_m", "hall_b_m", "hall_c_m")
AT = {"x_m": 1e-4, "y_m": -2e-4, "z_m": 1e-4}


@pytest.fixture(scope="module")
def stage() -> Fit:
    return hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")


def with_error(rest: float = 0.0, shape: Shape | None = None, *candidates: Candidate) -> Settings:
    return Settings(model_error=ModelError({"x_m": rest}, shape, candidates))


def test_what_is_left_adds_in_squares_to_its_coordinate(stage):
    plain, more = (position_budget(stage, AT, s) for s in (Settings(), with_error(2e-6)))
    assert more["x_m"].std == pytest.approx(np.hypot(plain["x_m"].std, 2e-6))
    assert more["y_m"].std == plain["y_m"].std
    assert [s.name for s in more["x_m"].sources][-1] == "model error: rest"


def test_a_shape_is_an_error_where_it_is(stage):
    """All probes read 1 um too much at Z = 0.1 mm: a decoded position moves by the sum of its slopes."""
    grid = np.array([-1e-4, 0.0, 1e-4])
    shape = Shape("z_m", grid, np.tile([0.0, 0.0, 1e-6], (3, 1)), np.zeros((3, 3)), gain=False)
    settings = with_error(0.0, shape)
    at, off = (position_budget(stage, AT | {"z_m": z}, settings)["x_m"] for z in (1e-4, -1e-4))
    (source,) = (s for s in at.sources if s.name == "model error: shape")
    slopes = [s.sensitivity for s in at.sources if s.name in ("hall_a noise", "hall_b noise", "hall_c noise")]
    assert source.std == pytest.approx(abs(sum(slopes)) * 1e-6)
    assert not any(s.name.startswith("model") for s in off.sources)
    gain = replace(shape, value=np.tile([0.0, 0.0, 1e-2], (3, 1)), gain=True)
    still = position_budget(stage, {"z_m": 1e-4}, with_error(0.0, gain))["x_m"]
    assert not any(s.name.startswith("model") for s in still.sources)  # a gain does nothing at the zero


def test_models_that_are_not_excluded_scatter(stage):
    """Two cubic terms of equal probability: half their difference, and nothing at the zeroing."""
    model = adapted(stage.model, ("odd_nonlinearity",), {})
    new = [n for n in model.names if n not in stage.model.names]
    known = stage.model.named(stage.values)
    two = [Candidate(model, model.vector(known | dict.fromkeys(new, c)), 1.0) for c in (0.0, 0.1)]
    settings = with_error(0.0, None, *two)
    at = position_budget(stage, AT, settings)["x_m"]
    (source,) = (s for s in at.sources if s.name == "model selection")
    one = position_budget(stage, AT, with_error(0.0, None, replace(two[0], weight=3.0), two[1]))["x_m"]
    (unlikely,) = (s for s in one.sources if s.name == "model selection")
    assert source.std > 1e-9
    assert unlikely.std == pytest.approx(source.std * 2 * np.sqrt(3) / 4)
    home = position_budget(stage, {}, settings)["x_m"]
    assert not any(s.name.startswith("model") for s in home.sources)


def test_maps_recordings_and_monte_carlo_hold_it_too(stage):
    settings, axes = with_error(2e-6), {"x_m": [-1e-4, 1e-4]}
    fixed = {"y_m": 0.0, "z_m": 0.0}
    maps = [uncertainty_map(stage, axes, s, fixed=fixed).expanded[0] for s in (Settings(), settings)]
    assert np.allclose(maps[1] ** 2 - maps[0] ** 2, (2 * 2e-6) ** 2)
    log = hallsym.bundled_campaign()
    rms = [over_log(stage, log, s).rms["x_m"] for s in (Settings(), settings)]
    assert rms[1] ** 2 - rms[0] ** 2 == pytest.approx((2 * 2e-6) ** 2)
    drawn = position_monte_carlo(stage, AT, settings, rng=np.random.default_rng(1), trials=20_000)["x_m"]
    assert drawn.std == pytest.approx(position_budget(stage, AT, settings)["x_m"].std, rel=0.03)


def record(folder: Path, **changes: object) -> Path:
    """A diagnosis as far as a budget reads it."""
    left = {"rest": {"x_m": 2e-6}, "shape_counts": False, "candidates": []}
    path = folder / "diagnosis.json"
    path.write_text(json.dumps({"model": "stage31", "model_error": left, "unexplained": {}} | changes))
    return path


def test_a_budget_reads_a_diagnosis(stage, tmp_path, capsys):
    stage.save(tmp_path / "calib.json")
    arguments = ["budget", str(tmp_path / "calib.json"), "--diagnosis", str(record(tmp_path)), "--json"]
    main(arguments)
    said = json.loads(capsys.readouterr().out)
    names = {c: [s["name"] for s in b["sources"]] for c, b in said["budgets"].items()}
    assert "model error: rest" in names["x_m"]
    assert "model error: rest" not in names["y_m"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"model": "stage30"}, "is a diagnosis of stage30"),
        ({"model_error": {"rest": 3}}, "cannot be read"),
        ({"model_error": {"rest": {}, "shape_counts": True}, "unexplained": {"curve": {}}}, "cannot be read"),
    ],
)
def test_another_record_is_refused(stage, tmp_path, changes, said):
    with pytest.raises(InputError, match=said):
        read_model_error(record(tmp_path, **changes), stage.model)
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InputError, match="holds no diagnosis"):
        read_model_error(tmp_path / "other.json", stage.model)
    with pytest.raises(InputError, match="does not exist"):
        read_model_error(tmp_path / "absent.json", stage.model)
