"""Calibrations in files: what is saved comes back, and what is not hallsym's is refused."""

import json

import numpy as np
import pytest
from msgspec.structs import fields
from twins import record, with_noise

from hallsym.errors import InputError
from hallsym.estimation import fit, load_fit
from hallsym.estimation.calibration import Claim
from hallsym.log import Noise, Sigma


@pytest.fixture(scope="module")
def rich():
    """A fit with something in every field."""
    columns = record(seed=1, samples=30, runs=15)
    mixed = {**columns, "hall_a_m": columns["hall_b_m"], "hall_b_m": columns["hall_a_m"]}
    made = fit(
        with_noise(mixed),
        "stage30",
        solver="direct",
        effects=("vertical_coupling", "exact_rotation"),
        parameters={
            "theta_C": {"fixed": True},
            "eta_B": {"lower": 0.71, "nominal": 0.72},
            "delta_A": {"upper": 5e-5},
            "a_A": {"lower": -float("inf")},  # no number of JSON, but an allowed bound
        },
        holdout=(3,),
        corrections=("exchange hall_a_m hall_b_m",),
        accept=("all",),  # no search: the claim is made up
    )
    noise = Noise({**made.noise, "z_m": Sigma(1e-8, "estimated", within=1.2)})
    claim = Claim("delay", "Late.", ("hall_a_m",), (3,), "delay hall_a_m 2", 0.9, ("delay hall_b_m 2",))
    return made.changed(noise=noise, claims=(claim,))


LIVE = ("keep", "source", "likelihood", "determination")
"""Fields of a fit just made that a file does not hold."""


def test_saving_and_loading_keeps_every_field(rich, tmp_path):
    path = tmp_path / "calib.json"
    rich.save(path)
    back = load_fit(path)
    assert back.to_dict() == rich.to_dict()
    for field in fields(rich):
        one, two = getattr(rich, field.name), getattr(back, field.name)
        if field.name in ("model", "errors", "offsets", "noise", "log") or field.name in LIVE:
            continue
        if isinstance(one, np.ndarray):
            assert np.array_equal(one, two, equal_nan=one.dtype.kind == "f"), field.name
        else:
            assert one == two, field.name
    assert back.noise.sigmas == rich.noise.sigmas
    assert {r: d.tolist() for r, d in back.offsets.items()} == {
        r: d.tolist() for r, d in rich.offsets.items()
    }
    assert back.model.parameters == rich.model.parameters
    assert back.model.offsets == rich.model.offsets
    assert (back.model.name, back.model.effects, back.model.layout) == (
        rich.model.name, rich.model.effects, rich.model.layout,
    )  # fmt: skip
    path.write_text(path.read_text().replace('"fixed"', '"held"'))  # as an earlier version of the format
    assert load_fit(path).to_dict() == rich.to_dict()
    raw = json.loads(path.read_text())
    assert list(raw)[:2] == ["format", "goodness_of_fit"]
    assert raw.pop("goodness_of_fit")["statement"] == rich.goodness.sentence  # a still earlier one had none
    for entry in raw["parameters"].values():
        del entry["degrees_of_freedom"]
    path.write_text(json.dumps(raw))
    assert load_fit(path).goodness is None
    assert np.all(np.isinf(load_fit(path).degrees_of_freedom))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[1, 2]",
        '{"format": "hallsym calibration 0"}',
        '{"format": "hallsym calibration 1"}',
        "\xff",
    ],
)
def test_foreign_files_are_refused(tmp_path, text):
    path = tmp_path / "calib.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(InputError):
        load_fit(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load_fit(tmp_path / "none.json")
