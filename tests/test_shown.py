"""Results in a session: a few lines, what the command prints, tables, pictures, files, pages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from twins import bundled

import hallsym
from hallsym.errors import InputError, commanded
from hallsym.report.content import document
from hallsym.report.views import _CONTENTS, content
from hallsym.shown import Shown


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    """Some runs of the bundled campaign, at other heights."""
    return bundled(slice(12))


@pytest.fixture(scope="module")
def fit(columns: dict[str, np.ndarray]) -> hallsym.Fit:
    return hallsym.fit(columns, "stage31", solver="direct")


@pytest.fixture(scope="module")
def results(columns: dict[str, np.ndarray], fit: hallsym.Fit) -> dict[str, Any]:
    """One result of each kind."""
    turn = np.arange(72) * 2 * np.pi / 72  # knots of an encoder whose readings have a harmonic
    angle = turn + 4e-3 * np.sin(4 * turn) + np.random.default_rng(4).normal(0, 2e-4, 72)
    ranges, values = hallsym.paper_ranges(), dict(zip(fit.model.names, fit.values, strict=True))
    return {
        "Fit": fit,
        "Evaluation": hallsym.evaluate(fit, columns),
        "Diagnosis": hallsym.diagnose({"angle_ref_rad": turn, "angle_rad": angle}, "rotary"),
        "Identifiability": hallsym.identify(fit, profiles="none"),
        "Belonging": hallsym.belonging(hallsym.evaluate(fit, columns)),
        "Generated": hallsym.generate(fit, allow_undetermined=True),
        "Plan": hallsym.plan(ranges, "stage31", values, fit.noise.std, runs=6),
        "Budget": hallsym.position_budget(fit)["x_m"],
        "UncertaintyMap": hallsym.uncertainty_map(fit, {"x_m": (-1e-4, 1e-4), "y_m": (0.0, 1e-4)}),
        "ErrorModel": hallsym.error_model(fit.model, {"H1x": 0.2}, over=("x_m", -1e-3, 1e-3)),
    }


KINDS = (
    "Fit", "Evaluation", "Diagnosis", "Identifiability", "Plan", "Budget", "UncertaintyMap", "ErrorModel",
)  # fmt: skip
NOT_RESULTS = {"Curve"}
"""Types with a record that are input too."""


def test_every_result_has_the_same_methods() -> None:
    kinds = [getattr(hallsym, name) for name in hallsym.__all__]
    recorded = {k.__name__: k for k in kinds if isinstance(k, type) and hasattr(k, "to_dict")}
    assert {name for name, kind in recorded.items() if not issubclass(kind, Shown)} == NOT_RESULTS
    assert recorded.keys() - NOT_RESULTS | {"TurnPlan", "UncertaintyMap"} == _CONTENTS.keys()


@pytest.mark.parametrize("kind", ["Belonging", "Generated"])
def test_a_result_without_a_picture_shows_itself_too(results: dict[str, Any], kind: str) -> None:
    result = results[kind]
    assert len(repr(result)) < 1500
    assert len(result.summary().split("\n")) >= 3 - (kind == "Belonging")
    assert len(result.to_dataframe()) > 0
    with pytest.raises(InputError, match="has no picture"):
        result.plot()
    assert 'class="card ' in document(content(result))


@pytest.mark.parametrize("kind", KINDS)
def test_a_result_shows_itself_in_every_form(results: dict[str, Any], kind: str, tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    result = results[kind]
    assert len(repr(result)) < 1500
    assert repr(result).count("\n") < 15
    assert len(result.summary().split("\n")) >= 3
    frame = result.to_dataframe()
    assert len(frame) > 0
    assert frame.columns[0] in ("parameter", "run", "effect", "runs", "source", "x_m", "output")
    figure = result.plot()
    assert isinstance(figure, Figure)
    figure.savefig(tmp_path / "a.png")
    result.save(tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text()) == json.loads(json.dumps(result.to_dict()))
    html = result._repr_html_()
    assert html.count("<svg") >= (kind != "Diagnosis")
    assert "<table" in html or kind in ("Plan", "Budget", "Identifiability")
    assert "var(--" not in html
    assert "<script" not in html
    assert figure._repr_svg_().startswith("<?xml")
    page = hallsym.report(result, tmp_path / "page.html").read_text(encoding="utf-8")
    for part in ("viewport", 'class="card ', "prefers-color-scheme", "@media print", 'id="verdict"'):
        assert part in page, part
    assert "<svg viewBox" in page or kind == "Diagnosis"
    assert 'class="key"' in page or kind != "Plan"


def test_a_calibration_that_was_read_is_shown_with_its_log(
    results: dict[str, Any], columns: dict[str, np.ndarray], tmp_path: Path
) -> None:
    fit = results["Fit"]
    fit.save(tmp_path / "calib.json")
    read = hallsym.load_fit(tmp_path / "calib.json")
    with pytest.raises(InputError, match="does not hold its log"):
        hallsym.report(read, tmp_path / "again.html")
    with pytest.raises(InputError, match="does not hold its log"):
        read.plot()
    assert hallsym.report(tmp_path / "calib.json", tmp_path / "again.html", columns).is_file()
    assert read.plot(columns) is not None


@pytest.mark.slow
def test_a_frame_of_any_library_gives_the_same_fit(
    columns: dict[str, np.ndarray], fit: hallsym.Fit, tmp_path: Path
) -> None:
    pandas, polars = pytest.importorskip("pandas"), pytest.importorskip("polars")
    duckdb, arrow = pytest.importorskip("duckdb"), pytest.importorskip("pyarrow")
    recorded = arrow.table(columns)
    hallsym.write_log(columns, tmp_path / "log.parquet")
    frames = {
        "pandas": pandas.DataFrame(columns),
        "polars": polars.DataFrame(columns),
        "pyarrow": recorded,
        "duckdb": duckdb.sql("select * from recorded"),
        "lists": {name: values.tolist() for name, values in columns.items()},
        "log": hallsym.Log.from_arrays(columns),
        "path": tmp_path / "log.parquet",
        "text": str(tmp_path / "log.parquet"),
    }
    for name, frame in frames.items():
        found = hallsym.fit(frame, "stage31", solver="direct")
        assert np.array_equal(found.values, fit.values), name
        assert np.array_equal(found.covariance, fit.covariance), name
    judged = hallsym.evaluate(fit, frames["polars"])
    assert judged.table.over() == hallsym.evaluate(fit, columns).table.over()


def test_a_frame_may_state_units_in_its_names(columns: dict[str, np.ndarray], fit: hallsym.Fit) -> None:
    polars = pytest.importorskip("polars")
    frame = polars.DataFrame(columns).with_columns(
        (polars.col("x_ref_m") * 1e6).alias("x_ref [µm]"), polars.lit("idle").alias("state")
    )
    log = hallsym.read_log(frame.drop("x_ref_m").rename({"hall_a_m": "A"}), columns={"hall_a_m": "A"})
    assert set(log.columns) == set(columns)
    assert np.allclose(hallsym.fit(log, "stage31", solver="direct").values, fit.values, rtol=1e-6)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (3, "must be a path, a dict of arrays"),
        ({"x_ref_m": [1, 2], "t_s": [1]}, "vector as long as the others"),
        ({"a": [1, 2]}, "no column whose name ends with a unit"),
    ],
)
def test_what_is_no_table_is_refused(data: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        hallsym.fit(data, "stage31")


def test_a_fit_names_its_rows_as_its_command_does(fit: hallsym.Fit) -> None:
    rows = [line[:13] for line in fit.summary().split("\n") if line.startswith(("rmse, ", "peak, "))]
    assert rows == ["rmse, nominal", "rmse, fitted ", "peak, nominal", "peak, fitted "]
    assert all(f"\n{row} " in repr(fit) for row in rows)
    assert "designed" not in repr(fit)


def test_parameters_of_a_fit_have_their_interval(fit: hallsym.Fit) -> None:
    known, lost = fit.params["eta_A"], fit.params["H1x"]
    assert (lost.std, lost.interval) == (None, None)
    assert known.value == fit.value("eta_A")
    assert known.interval is not None
    assert known.std is not None
    assert known.interval[1] - known.value == pytest.approx(known.factor * known.std)
    wide, usual = fit.conf_int(0.99)["eta_A"], fit.conf_int()["eta_A"]
    assert usual == known.interval
    assert wide is not None
    assert wide[0] < known.interval[0]
    with pytest.raises(InputError, match="between 0 and 1"):
        fit.conf_int(95)
    at = [fit.model.names.index(n) for n in ("eta_A", "H1x")]
    r = fit.correlation
    assert r[at[0], at[0]] == pytest.approx(1)
    assert np.isnan(r[at[1], at[1]])
    assert np.nanmax(np.abs(r)) < 1 + 1e-9


def test_predictions_and_residuals_agree_with_the_error_table(
    columns: dict[str, np.ndarray], fit: hallsym.Fit, tmp_path: Path
) -> None:
    left, pose = fit.residuals(columns), fit.predict(columns)
    held = np.isin(left["run"], fit.errors.holdout if fit.errors else ())
    rmse = fit.errors.rows()["fitted"]["rmse"] if fit.errors else {}
    for c, reference in zip(fit.model.pose, fit.model.references, strict=True):
        assert np.sqrt(np.mean(left[c][~held] ** 2)) == pytest.approx(rmse[c], rel=1e-9)
        assert np.allclose(pose[c] - columns[reference], left[c], rtol=0, atol=1e-15)
    bare = {c: v for c, v in columns.items() if c not in fit.model.references}
    zeroed = fit.predict(bare)  # as a controller decodes: offsets of a run are in the error
    assert 1e-7 < np.std(zeroed["x_m"] - columns["x_ref_m"]) < 1e-5
    fit.save(tmp_path / "calib.json")
    other = hallsym.load_fit(tmp_path / "calib.json").residuals({c: v[:3000] for c, v in columns.items()})
    assert np.std(other["x_m"]) < 3e-6
    with pytest.raises(InputError, match="no column z_m"):
        fit.predict({"hall_a_m": [1.0, 2.0]})


def test_errors_of_calls_advise_arguments_and_those_of_commands_options(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("HALLSYM_COMMANDED")
    with pytest.raises(InputError, match=r"columns={'hall_a_um': 'ITS_NAME'}"):
        hallsym.fit({"a": [1, 2]}, "stage31")
    with commanded(), pytest.raises(InputError, match="--column hall_a_um=ITS_NAME"):
        hallsym.fit({"a": [1, 2]}, "stage31")
    said = str(InputError("Leave bad samples out with --drop-bad, or see 'hallsym info LOG --write'."))
    assert said == "Leave bad samples out with drop_bad=True, or see 'hallsym info LOG --write'."
