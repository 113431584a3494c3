"""Ranges of tolerances, given and usual, and the command and picture of a study."""

import json
import re

import numpy as np
import pytest

from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.families import build
from hallsym.families.published import bounds
from hallsym.uncertainty.gum import DIVISORS
from hallsym.uncertainty.ranges import Tolerance, default_tolerances, given_tolerances
from hallsym.uncertainty.tolerances import tolerances


def test_default_ranges_are_table_3_about_table_1(model):
    for t in default_tolerances(model):
        low, high = bounds()[t.name]
        assert t.width == pytest.approx((high - low) / 2)
        assert t.centre == t.nominal
    assert default_tolerances(model.with_parameters({"H1x": {"lower": 0.2, "upper": 0.2}}))[0].width == 0


def test_units_stand_in_the_key(model):
    given = {
        "H1x_um": 20, "H1y_mm": 0.02, "theta_A_deg": 0.1, "eta_A_percent": 2, "eta_B": 0.02,
        "H2x_percent": 1, "theta_B_mrad": {"half_width": 3, "distribution": "triangular"},
        "eta_C": [0.9, 1.0], "H3y": "exact",
    }  # fmt: skip
    found = {t.name: t for t in given_tolerances(model, given, "exact")}
    width = {name: t.width for name, t in found.items()}
    assert width["H1x"] == pytest.approx(20e-6)
    assert width["H1y"] == pytest.approx(20e-6)
    assert width["theta_A"] == pytest.approx(np.radians(0.1))
    assert width["eta_A"] == pytest.approx(0.02)
    assert width["eta_B"] == pytest.approx(0.02)
    assert width["H2x"] == pytest.approx(0.001975)
    assert found["theta_B"].std == pytest.approx(3e-3 / 6**0.5)
    assert (found["eta_C"].centre, found["eta_C"].width) == pytest.approx((0.95, 0.05))
    assert width["H3y"] == width["H2y"] == 0
    coupled = given_tolerances(build("stage31"), {"a_A_per_mm": 0.2, "b_B_per_mrad": 0.1}, "exact")
    named = {t.name: t.width for t in coupled}
    assert (named["a_A"], named["b_B"]) == pytest.approx((200, 100))


@pytest.mark.parametrize("distribution", [*DIVISORS, "normal"])
def test_draws_have_the_standard_uncertainty(distribution):
    """Shapes are those of the sources of a budget."""
    t = Tolerance("H1x", "m", 1.0, 1.0, 0.3, distribution)
    u = (np.arange(100_000) + 0.5) / 100_000
    assert (t.at(u).mean(), t.at(u).std()) == pytest.approx((1.0, t.std), rel=1e-3)
    assert np.all(np.diff(t.at(u)) > 0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"H1z_um": 20}, "'H1z_um' in .* names no parameter of stage15 .did you mean 'H1"),
        ({"H1x": 20}, "must end with a unit of H1x"),
        ({"theta_A_percent": 1}, "must end with a unit of theta_A"),
        ({"H1x_um": 0}, "must be a positive number"),
        ({"H1x_um": "20"}, "must be a positive number; instead received '20'"),
        ({"H1x_um": 20, "H1x_mm": 1}, "H1x has two tolerances"),
        ({"H1x_um": {"std": 1, "half_width": 2}}, "must have half_width or std, one of them"),
        ({"H1x_um": {"half_width": 1, "distribution": "flat"}}, "one of rectangular, triangular, arcsine"),
        ({"H1x_um": {"sigma": 1}}, "Unknown key 'sigma'"),
        ({"eta_A": [0.98, 0.78]}, r"must be \[low, high\], low < high"),
    ],
)
def test_ranges_that_cannot_be(model, given, words):
    with pytest.raises(InputError, match=words) as caught:
        given_tolerances(model, given)
    assert str(caught.value).endswith(".")


def test_studies_that_cannot_be(model, somewhere):
    for samples in (1000, 8, 0, -4, 2**17):
        with pytest.raises(InputError, match="'samples' must be a power of two"):
            tolerances(model, somewhere, samples=samples)
    with pytest.raises(InputError, match="Every parameter of stage15 is exact"):
        tolerances(model, somewhere, ranges=given_tolerances(model, {}, "exact"))
    with pytest.raises(InputError, match="seed must be a whole number, 0 or more"):
        tolerances(model, somewhere, seed=-1)
    with pytest.raises(InputError, match="one Tolerance per parameter of stage15"):
        tolerances(model, somewhere, ranges=default_tolerances(model)[:3])
    free = model.with_parameters({"H1x": {"upper": np.inf}})
    with pytest.raises(InputError, match="H1x of stage15 has no finite bounds"):
        tolerances(free, somewhere)
    assert tolerances(free, somewhere, ranges={"H1x_um": 20}, samples=16).active == (*free.names,)


# -- command and picture ---------------------------------------------------------------------------------


def test_the_command_prints_the_ranking_first(capsys, tmp_path):
    (tmp_path / "drawing.toml").write_text('others = "exact"\n[tolerance]\nH1x_um = 20\neta_A_percent = 2\n')
    words = ["tolerances", "--ranges", str(tmp_path / "drawing.toml"), "--samples", "32"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert out.index("errors of the nominal decoder") < out.index("fall of the") < out.index("Sobol indices")
    rows = [line.split()[0] for line in out.splitlines() if line.startswith(("eta_A ", "H1x "))]
    assert rows == ["eta_A", "H1x", "eta_A", "H1x"]
    assert "sharp enough to rank" in out
    assert main(["tolerances", "--model", "rotary", "--samples", "32"]) == 0
    wanted = re.search(
        r"too wide to rank by: about --samples (\d+) brings them below 5", capsys.readouterr().out
    )
    assert wanted
    assert int(wanted[1]) > 32
    assert main([*words, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["ranking"] == ["eta_A", "H1x"]
    assert record["tolerances"]["H1x"]["std"] == pytest.approx(20e-6 / 3**0.5)
    assert record["tolerances"]["theta_A"]["width"] == 0
    assert set(record["indices"]["y_m"]["eta_A"]) == {"first", "first_half", "total", "total_half"}


def test_usual_tolerances_of_a_family():
    """What the family states, by the pattern of the parameter; else the bounds; a fixed one stays exact."""
    model = build("halbach", added=("gain_mismatch", "wavelength_error"))
    fixed = model.with_parameters({"gain_2": {"lower": 0.0, "upper": 0.0}})
    found = {t.name: t for t in default_tolerances(fixed)}
    assert found["a1"].width == pytest.approx(0.02 * 0.6)
    assert found["gain_0"].width == pytest.approx(0.025)
    assert {found[n].source for n in ("a1", "gain_0", "b5")} == {"usual"}
    assert (found["b5"].width, found["gain_2"].width) == (0, 0)
    other = next(t for n, t in found.items() if n not in ("a1", "b1", "a5", "b5") and "gain" not in n)
    assert other.source == "bounds"
