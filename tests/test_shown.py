"""Results in a session: a few lines, what the command prints, tables, pictures, files, pages."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hallsym
from hallsym.errors import InputError
from hallsym.report.text.fit import fit_text


@pytest.fixture(scope="module")
def columns() -> dict[str, np.ndarray]:
    """Some runs of the bundled campaign, at other heights."""
    log = hallsym.bundled_campaign()
    run = log.array("run").astype(int)
    chosen = np.isin(run, log.runs[:12])
    return {c: run[chosen] if c == "run" else log.array(c)[chosen] for c in log.columns}


@pytest.fixture(scope="module")
def fit(columns: dict[str, np.ndarray]) -> hallsym.Fit:
    return hallsym.fit(columns, "stage31", solver="direct")


@pytest.fixture(scope="module")
def results(columns: dict[str, np.ndarray], fit: hallsym.Fit) -> dict[str, Any]:
    """One result of each kind."""
    ranges, values = hallsym.paper_ranges(), dict(zip(fit.model.names, fit.values, strict=True))
    return {
        "Fit": fit,
        "Evaluation": hallsym.evaluate(fit, columns),
        "Diagnosis": hallsym.diagnose(columns, "stage30"),
        "Identifiability": hallsym.identify(fit, profiles="none"),
        "Plan": hallsym.plan(ranges, "stage31", values, fit.noise.std, runs=6),
        "Budget": hallsym.position_budget(fit)["x_m"],
    }


KINDS = ("Fit", "Evaluation", "Diagnosis", "Identifiability", "Plan", "Budget")


@pytest.mark.parametrize("kind", KINDS)
def test_a_result_shows_itself(results: dict[str, Any], kind: str, tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    result = results[kind]
    assert len(repr(result)) < 1500
    assert repr(result).count("\n") < 12
    assert len(result.summary().split("\n")) >= 3
    frame = result.to_dataframe()
    assert len(frame) > 0
    assert frame.columns[0] in ("parameter", "run", "effect", "runs", "source")
    figure = result.plot()
    assert isinstance(figure, Figure)
    figure.savefig(tmp_path / "a.png")
    result.save(tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_text()) == json.loads(json.dumps(result.to_dict()))


def test_the_summary_is_what_the_command_prints(fit: hallsym.Fit) -> None:
    assert fit.summary() == fit_text(fit)
    assert fit.to_dataframe().set_index("parameter")["value"]["eta_A"] == fit.value("eta_A")


def test_pages_of_results(results: dict[str, Any], columns: dict[str, np.ndarray], tmp_path: Path) -> None:
    fit = results["Fit"]
    path = hallsym.report(fit, tmp_path / "fit.html")
    assert "<h1" in path.read_text(encoding="utf-8")
    assert "<h1" in hallsym.report(results["Diagnosis"], tmp_path / "gap.html").read_text(encoding="utf-8")
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


def test_help_lists_columns_units_results_and_an_example() -> None:
    text = hallsym.fit.__doc__ or ""
    for word in (
        "hall_a_m",
        "x_ref_m",
        "v_sin_v",
        "x_ref [um]",
        "std",
        "errors.rows()",
        ">>> fit =",
        "polars",
    ):
        assert word in text, word


def test_importing_hallsym_loads_no_library() -> None:
    heavy = "{'numpy', 'pyarrow', 'matplotlib', 'pandas', 'casadi'}"
    code = f"import hallsym, sys; print(*{heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_a_fit_names_its_rows_as_its_command_does(fit: hallsym.Fit) -> None:
    rows = [line.split()[0] for line in fit_text(fit).split("\n") if line.startswith(("nominal ", "fitted "))]
    assert rows == ["nominal", "fitted"]
    assert all(f"\n{row} " in repr(fit) for row in rows)
    assert "designed" not in repr(fit)
