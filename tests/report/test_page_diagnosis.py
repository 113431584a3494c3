"""The page of a diagnosis, from hand-made records: nothing of a record is lost."""

import copy
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reports import run_series
from test_page import Outline

from hallsym.diagnosis import Diagnosis
from hallsym.output import PROSE
from hallsym.report.content import document, printed
from hallsym.report.data.gather import Cells
from hallsym.report.results.diagnosis import diagnosis_content
from hallsym.report.views import summary

POSE = ("x_m", "y_m", "rz_rad")


def gap(size: float) -> dict[str, dict[str, float]]:
    return {
        "rmse": {c: size * k for c, k in zip(POSE, (1.0, 1.5, 1.2), strict=True)},
        "peak": {c: 4 * size * k for c, k in zip(POSE, (1.0, 1.5, 1.2), strict=True)},
    }


def side(rms: float, noise: float, share: float | None) -> dict[str, float | None]:
    above = float(np.sqrt(rms**2 - noise**2))
    return {"rms": rms, "noise": noise, "above": above, "share": share, "p_value": 1e-4}


def a_shape(line: bool = True) -> dict[str, Any]:
    """A curve as `diagnosis.shape` gives it; nothing is known of the last place of Hall B."""
    grid = np.linspace(-2.5e-4, 2.5e-4, 9) if line else np.arange(6.0)
    value = 0.01 * np.cos(np.arange(len(grid)))
    one = {"value": value.tolist(), "low": (value - 2e-3).tolist(), "high": (value + 2e-3).tolist()}
    two = {k: [*v[:-1], 0.0] for k, v in one.items()}
    return {
        "coordinate": "height Z" if line else "height Z and tilts Rx, Ry",
        "line": line,
        "column": "z_m",
        "unit": "m" if line else "1",
        "kind": "gain" if line else "offset",
        "value_unit": "1",
        "grid": grid.tolist(),
        "labels": None
        if line
        else ["offset, Z", "offset, Rx", "offset, Ry", "gain, Z", "gain, Rx", "gain, Ry"],
        "readings": {"hall_a_m": one, "hall_b_m": two, "hall_c_m": one},
    }


def a_record() -> dict[str, Any]:
    return {
        "verdict": "explained",
        "sentence": "vertical_gain_coupling lowers the rmse by 61 %.",
        "noise_floor": {"x_m": 1.1e-6, "y_m": 1.6e-6, "rz_rad": 1.3e-6, "source": "estimated"},
        "gap_before": gap(3e-6),
        "gap_after": gap(1.2e-6),
        "metric": {"before": 2.7e-6, "after": 1.1e-6, "floor": 1e-6},
        "shrinkage": {"value": 0.61, "interval": [0.57, 0.64], "share_closed": 0.97, "parameters_added": 11,
                      "judges": 57},
        "ranked": ["vertical_gain_coupling", "time_skew", "lag"],
        "groups": [["time_skew", "lag"]],
        "effects": [
            {
                "name": "vertical_gain_coupling", "link": "field", "variant": "linear",
                "parameters": {
                    "a_A": {"value": -131.2, "std": 1.1, "unit": "1/m"},
                    "b_A": {"value": 0.022, "std": None, "unit": "1/rad"},
                },
                "p_value": 0.0, "shrinkage": 0.58, "interval": [0.54, 0.62],
                "share": 0.93, "cost": "9 parameters",
            },
            {
                "name": "time_skew", "link": "clock", "variant": "",
                "parameters": {"tau": {"value": 1.3e-4, "std": 2e-5, "unit": "s"}},
                "p_value": 3e-9, "shrinkage": 0.07, "interval": [-0.01, 0.12],
                "share": 0.04, "cost": "1 parameter",
            },
        ],
        "where": [
            {"by": "height Z", "at": "bin 8 of 8", "share": 0.62, "p_value": 1e-20, "held_out": 0.58,
             "text": "62 % lies in height Z"},
            {"by": "sensor", "at": "hall_b_m", "share": 0.41, "p_value": 1e-9,
             "text": "41 % is seen by hall_b_m"},
        ],
        "remaining": [
            {"by": "run", "at": "bin 3 of 57", "share": 0.05, "p_value": 2e-4,
             "text": "5 % differs from run to run"}
        ],
        "separate_by": [
            {"group": ["time_skew", "lag"], "recording": "y at 4 Hz and at 20 Hz", "sigma_now": 1.2}
        ],
        "size": {
            "outputs": {"x_m": {"fitted": side(2.5e-6, 1.1e-6, 0.4), "held_out": side(3e-6, 1.1e-6, 0.55)}},
            "sensors": {
                "hall_b_m": {"fitted": side(1.2e-6, 6e-7, 0.12), "held_out": side(1.3e-6, 6e-7, None)},
            },
        },
        "unexplained": {"share": 0.35, "curve": a_shape()},
        "validation_runs": [2, 7, 12, 13, 14],
        "not_testable": {"gain_temperature": "no temperature logged"},
        "smaller_findings": [{"name": "quantisation", "shrinkage": 0.012, "p_value": 1e-4}],
        "threshold": 0.05,
        "model": "stage30",
        "log": {"path": "lab/a <b>&\"c\".csv", "sha256": "ab" * 32, "rows": 5700, "runs": 57},
        "notes": ["A note & more."],
        "seconds": 3.1,
        "versions": {"hallsym": "0.1.0"},
    }  # fmt: skip


def page_of(record: dict[str, Any], **more: Any) -> str:
    return document(diagnosis_content(Diagnosis.from_dict(record), **more))


def test_everything_of_a_record_is_said(monkeypatch):
    monkeypatch.setenv("COLUMNS", str(PROSE))
    lines = summary(Diagnosis.from_dict(a_record())).splitlines()
    assert max(map(len, lines)) <= PROSE
    told = " ".join(" ".join(lines).split())
    for words in ("a_A -131.2(11) 1/m", "tau 0.130(20) ms", "58.0 % (54.0 to 62.0) 93 % < 1e-6"):
        assert words in told, words
    outline = Outline(page_of(a_record(), command="hallsym diagnose log.csv"))
    text = outline.text
    for words in (
        "Explained. vertical_gain_coupling lowers the rmse by 61 %.",
        "noise floor, estimated 1.1 1.6 1.3",
        "rmse, before 3 4.5 3.6 rmse, after 1.2 1.8 1.44",
        "peak, before 12 18 14.4 peak, after 4.8 7.2 5.76",
        "the error is one number over all outputs, on 5 holdout runs",
        "vertical_gain_coupling field linear 58.0 % (54.0 to 62.0) 93 % < 1e−6",
        "time_skew clock 7.0 % (−1.0 to 12.0) 4 % < 1e−6 lag",
        "time_skew, lag they are confusable on this log (1.2 sigma). Record y at 4 Hz and at 20 Hz.",
        "62 % lies in height Z",
        "a_A −131.2(11) 1/m",
        "gain_temperature not testable, no temperature logged",
        "quantisation significant, lowers the gap by 1.2 %",
        "A note & more.",
        'a <b>&"c".csv',
        "hallsym diagnose log.csv",
    ):
        assert words in text, words


def test_the_picture_of_a_gap_says_sizes_and_floor():
    picture = diagnosis_content(Diagnosis.from_dict(a_record())).pictures["gap"](None)
    assert len(picture.panels) == 6
    assert picture.panels[0].says == "rmse x [µm]: before 3; after 1.2; noise floor 1.1"
    assert picture.panels[3].says == "peak x [µm]: before 12; after 4.8"


def test_no_gap_needs_no_effects():
    record = a_record()
    record |= {"verdict": "no gap", "effects": [], "ranked": [], "groups": [], "separate_by": [], "where": []}
    record |= {
        "remaining": [],
        "unexplained": {},
        "gap_after": record["gap_before"],
        "sentence": "The rmse is at the noise floor.",
    }
    outline = Outline(page_of(record))
    assert "No gap. The rmse is at the noise floor." in outline.text
    assert "None. No effect of the catalogue lowers the gap" in outline.text
    assert "depends on no logged quantity" in outline.text
    assert "rest" not in [a["id"] for a in outline.all("section")]
    assert "after" not in outline.text


def test_intervals_of_the_error_stand_below_it():
    record = a_record()
    record["gap_after"]["interval"] = {"x_m": (1.1e-6, 1.32e-6), "rz_rad": (1e-6, 2e-6)}
    text = Outline(page_of(record)).text
    assert "95 % interval, after 1.1 .. 1.32 1 .. 2 noise floor" in text
    assert "95 % interval, before" not in text  # too few runs


def test_each_output_is_drawn_over_the_coordinate_that_it_follows_most():
    def along(by: str, *slopes: float) -> Cells:
        mean = np.outer(slopes, [-1e-6, 1e-6])
        return Cells(by, POSE, np.array([3, 4]), mean, np.abs(mean), edges=(-1.0, 0.0, 1.0))

    page = page_of(a_record(), maps={"before": [along("x [µm]", 2, 0, 0.5), along("y [µm]", 1, 3, 0.2)]})
    first = page.partition("each error follows most")[2].partition("</figure>")[0]
    assert re.findall(r">([xy] \[µm\])</text>", first) == [*2 * ["x [µm]"], *2 * ["y [µm]"], "x [µm]"]


def test_a_statement_that_was_not_confirmed_leaves_its_place_empty():
    record = a_record()
    record["where"][0]["held_out"] = None
    record["size"]["sensors"]["hall_b_m"].pop("held_out")
    page = page_of(record)
    assert not re.search(r"\bnan\b|\binf\b|\bNone\b(?!\.)", Outline(page).text)


def test_features_that_are_no_line_have_names_and_intervals():
    record = a_record()
    record["unexplained"]["curve"] = a_shape(line=False)
    page = page_of(record)
    assert "error of the reading per standard deviation of height Z and tilts Rx, Ry" in Outline(page).text
    assert page.count(">gain, Rx<") == 3


def test_what_was_not_measured_at_a_place_is_not_drawn():
    page = page_of(a_record())
    shapes = page.partition('id="rest"')[2].partition("</section>")[0].rpartition("<figure")[2]
    lines = re.findall(r'<path d="([^"]*)"[^>]* stroke="var\(--edge\)"', shapes)
    assert [line.count("L") for line in lines] == [8, 7, 8]


def test_maps_and_series_are_optional_and_shown():
    t = np.linspace(0, 4, 900)
    errors = {"before": 3e-6 * np.sin(t) * np.ones((3, 1)), "after": 1e-6 * np.cos(t) * np.ones((3, 1))}
    cells = Cells(
        by="x [µm]", pose=POSE, count=np.array([3, 0]), edges=(-10.0, 0.0, 10.0),
        mean=np.array([[1e-6, np.nan]] * 3), rms=np.array([[2e-6, np.nan]] * 3),
    )  # fmt: skip
    both = [cells, replace(cells, by="y [µm]")]
    series = [run_series("run 2", POSE, t, errors)]
    page, alone = (page_of(a_record(), maps={"before": maps}, series=series) for maps in (both, both[:1]))
    assert {"maps", "series"} <= {a["id"] for a in Outline(page).all("section")}
    # all that there is of a single coordinate stands above the sections, once
    assert "maps" not in {a["id"] for a in Outline(alone).all("section")}
    assert alone.count('aria-label="x by x [µm]') == 1
    assert "3 samples" in page
    over_time = page.partition('class="series"')[2]
    assert [over_time.count(f'stroke="var(--{look})"') for look in ("median0", "edge")] == [3, 3]
    assert "nan" not in page.partition("<body>")[2].partition("<script>")[0]


def test_all_but_the_first_picture_and_the_worst_of_many_sensors_are_folded():
    record, pose = a_record(), [*POSE, "z_m"]
    noise = {f"hall_{k}_v": {"fitted": side((1 + 0.01 * k) * 1e-3, 1e-3, None)} for k in range(20)}
    record["size"]["sensors"] = noise
    cells = Cells("x [µm]", tuple(pose), np.array([3]), np.ones((4, 1)), np.ones((4, 1)), edges=(0.0, 1.0))
    said = diagnosis_content(
        Diagnosis.from_dict(record), maps={"before": [cells, replace(cells, by="y [µm]")]}
    )
    page = document(said)
    folded = re.findall("<details>.*?</details>", page, re.S)
    summaries = [re.search("<summary>(.*?)</summary>", part)[1] for part in folded]
    assert summaries == ["and 14 sensors whose error is nearer to the noise", "over y [µm]"]
    assert [f"Hall {k} [" in folded[0] for k in (13, 14)] == [True, False]
    assert summaries[0] in printed(said)
    assert "Hall 13 " not in printed(said)


HOSTILE = st.text(alphabet="<>&\"'/=;!-scriptonerror \x00\udc80‮", max_size=30)


@pytest.mark.slow
@settings(max_examples=15)
@given(text=HOSTILE)
def test_no_text_of_a_record_becomes_markup(text):
    hostile = Outline(page_of(marked(f"x{text}")))
    assert hostile.outside == PLAIN.outside
    assert {name for name, _ in hostile.found} == {name for name, _ in PLAIN.found}


def marked(text: str) -> dict[str, Any]:
    """Return a record with `text` wherever a user's words may stand."""
    record = copy.deepcopy(a_record())
    record |= {
        "sentence": text,
        "model": text,
        "notes": [text],
        "not_testable": {text: text},
        "verdict": text,
    }
    record |= {"groups": [[text, "lag"]], "ranked": [text], "versions": {text: text}}
    record["log"] |= {"path": text, "sha256": text}
    record["noise_floor"]["source"] = text
    effect = record["effects"][0]
    effect |= {"name": text, "link": text, "variant": text, "cost": text}
    effect["parameters"] = {text: {"value": 1.0, "std": 0.1, "unit": text}}
    record["where"][0] |= {"by": text, "at": text, "text": text}
    record["separate_by"][0] |= {"group": [text, "lag"], "recording": text}
    return record


PLAIN = Outline(page_of(marked("x")))
