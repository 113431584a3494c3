"""`hallsym sort`: table, JSON, files and pictures; options that do not fit; sentences for bad input."""

import csv
import json
import re
from pathlib import Path

import pytest

from tests.sorting.benches import bench, written

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    columns, _ = bench(n=90, repeats=40)
    return written(tmp_path_factory.mktemp("bench") / "bench.csv", columns)


def test_sensors_are_sorted_and_matched(run, table, tmp_path):
    code, out, err = run(
        "sort", table, "--model", "stage31", "--sets", 4, "-o", tmp_path / "sets.csv",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert re.search("90 sensors sorted.*wrong bin.*repeatability.*matched", out, re.S)
    with (tmp_path / "sets.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 90
    assert sorted(row["place"] for row in rows if row["set"] == "4") == ["hall_a_m", "hall_b_m", "hall_c_m"]


def test_json_and_text_tell_the_same(run, table, tmp_path):
    code, out, _ = run("sort", table, "--model", "rotary", "--json")
    record = json.loads(out)
    assert code == 0
    assert len(record["sensors"]) == sum(entry["sensors"] for entry in record["bins"]) == 90
    assert record["matching"]["ways"][0]["way"] == "matched"
    assert len(record["matching"]["sets"]) == 45
    assert run("sort", table, "--model", "rotary", "-o", tmp_path / "all.json")[0] == 0
    saved = json.loads((tmp_path / "all.json").read_text())
    assert saved["sensors"] == record["sensors"]


def test_columns_are_mapped_and_fields_stated(run, table, tmp_path):
    lines = table.read_text().replace("sensor,", "ID,", 1).replace("reading_1_v", "Hall", 1).splitlines()
    kept = [0, 1, 3, 4, 6, 7]  # without the columns of the field
    other = tmp_path / "own.csv"
    other.write_text("\n".join(",".join(line.split(",")[k] for k in kept) for line in lines) + "\n")
    words = ["--column", "sensor=ID", "--column", "reading_1_v=Hall", "--field", "0mT,475mT"]
    code, out, err = run("sort", other, *words)
    assert (code, err) == (0, "")
    assert "90 sensors sorted" in out


def test_sets_for_a_calibration(run, table, tmp_path):
    calibration = tmp_path / "calibration.json"
    arguments = ("--model", "rotary", "--solver", "direct", "-o", calibration)
    assert run("fit", ROOT / "data" / "encoder", *arguments)[0] in (0, 3)
    code, out, err = run("sort", table, "--model", "rotary", "--values", calibration, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["matching"]["gain_over_bins"] > 1
    code, _, err = run("sort", table, "--model", "stage31", "--values", calibration)
    assert code == 2
    assert "--model rotary" in err
