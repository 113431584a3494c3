"""The page of a fit: everything that was asked for is there, once, escaped, the same bytes every time."""

import math
import re
import shlex
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from reports import HOLDOUT, run_series
from twins import Chopped, record, with_noise

from hallsym import load_fit, write_log
from hallsym.cli.main import main
from hallsym.estimation import Fit, fit
from hallsym.estimation.calibration import Claim
from hallsym.log import Log, read_log
from hallsym.report.content import document
from hallsym.report.data.gather import Cells, gather, worst_first
from hallsym.report.drawing import draw, svg
from hallsym.report.panels import ACROSS, UP, by_groups, plane, script_data
from hallsym.report.picture import Axis, Panel
from hallsym.report.results import shared
from hallsym.report.results.fit import page_content

VOID = {"meta", "br"}


class Outline(HTMLParser):
    """Checks that elements are closed in order, and gathers what a test looks at."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.outside: list[tuple[str, list[str]]] = []  # of pictures: elements with their attributes
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, name, attributes):
        self.found.append((name, dict(attributes)))
        if "svg" not in self.open:  # the heads of a table of long words stand in each row on a phone
            self.outside.append((name, sorted({*dict(attributes)} - {"data-head"})))
        if name not in VOID:
            self.open.append(name)

    def handle_endtag(self, name):
        assert self.open[-1:] == [name]
        self.open.pop()

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, name: str) -> list[dict[str, str | None]]:
        return [attributes for found, attributes in self.found if found == name]


@pytest.fixture(scope="module")
def page(log: Log, fitted: Fit) -> str:
    return document(page_content(log, fitted, command="hallsym report calib.json log.csv"))


# -- the page --------------------------------------------------------------------------------------------


def test_page_is_well_formed_and_has_its_sections(page: str):
    outline = Outline(page)
    sections = [a["id"] for a in outline.all("section")]
    assert sections == [
        "input", "maps", "series", "parameters", "notes", "origin",
    ]  # fmt: skip
    idents = [a["id"] for _, a in outline.found if "id" in a]
    assert len(idents) == len(set(idents))
    links = {a["href"] for a in outline.all("a") if "download" not in a}
    assert links == {f"#{s}" for s in sections}
    assert all(a.get("aria-label") for a in outline.all("svg") if a.get("role") == "img")
    assert len([a for a in outline.all("figure") if a.get("class") == "series"]) == 1


def test_page_says_what_the_fit_says(page: str, fitted: Fit, log: Log):
    text = Outline(page).text
    rows = fitted.errors.rows()
    for row, where in (
        (rows["holdout"], "holdout"),
        (rows["fitted"], "fitted"),
        (rows["designed"], "nominal"),
    ):
        for what in ("rmse", "peak"):
            sizes = [f"{1e6 * row[what][c]:.4g}" for c in fitted.model.pose]
            assert text.count(f"{what}, {where} {' '.join(sizes)} ") == 1
    assert "holdout runs 3 (2, 7, 12)" in text
    assert log.sha256 in text
    assert "hallsym report calib.json log.csv" in text
    for name in fitted.model.names:
        assert f" {name} " in text
    for combination in fitted.combinations:
        assert combination.expression in text
    assert text.count("; not identifiable from any recording") == len(fitted.structural)


def test_page_loads_nothing_and_is_small(page: str):
    assert len(page.encode()) < 1_500_000
    outline = Outline(page)
    assert {name for name, _ in outline.found} & {"link", "img", "iframe", "object", "image", "use"} == set()
    for _, attributes in outline.found:
        assert not {"src", "srcset", "style"} & set(attributes)
        assert not [a for a in attributes if a.startswith("on")]
    assert set(re.findall(r"https?://[^\s\"'<]*", page)) <= {"http://www.w3.org/2000/svg"}
    assert "@import" not in page
    assert "url(" not in page


def test_every_colour_of_a_figure_follows_the_page(page: str):
    looks = set(re.findall(r' (?:fill|stroke)="([^"]*)"', page))
    assert {"var(--ink)", "var(--edge)", "var(--median0)", "var(--pos)"} <= looks
    assert [look for look in looks if not look.startswith("var(--") and look != "none"] == []


@pytest.mark.slow
def test_saved_calibration_gives_the_same_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_log(record(seed=2), "log.csv")
    read = read_log("log.csv")
    result = fit(read, "stage31", solver="direct", loss="none", holdout=HOLDOUT)
    result.save("calib.json")
    assert main(["report", "calib.json", "log.csv", "-o", "page.html"]) == 0
    assert "wrote page.html" in capsys.readouterr().out
    first = Path("page.html").read_bytes()
    (typed,) = re.findall(r"<dt>command</dt><dd><code>(.*?)</code>", first.decode())
    assert main(shlex.split(re.sub("</?span>", "", typed))[1:]) == 0
    assert Path("report.html").read_bytes() == first  # the printed command writes it again
    assert (
        document(
            page_content(read, load_fit("calib.json"), command="hallsym report calib.json log.csv")
        ).encode()
        == first
    )


def test_names_are_escaped_everywhere(tmp_path, capsys):
    folder = tmp_path / "a <b>&\"c\" '<script>alert(1)</script>'".replace("/", "_")
    folder.mkdir()
    path = folder / 'log <img src=x onerror=alert(1)>&".csv'
    write_log(record(seed=3, samples=20, runs=15), path)
    fit(read_log(path), "stage31", solver="direct", loss="none").save(folder / "calib.json")
    assert main(["report", str(folder / "calib.json"), str(path), "-o", str(folder / "p.html")]) == 0
    text = (folder / "p.html").read_text(encoding="utf-8")
    outline = Outline(text)
    assert [a.get("type") for a in outline.all("script")] == ["application/json", None]
    assert outline.all("img") == outline.all("b") == []
    assert path.name in outline.text


def test_spikes_that_the_fit_left_out_stay_out_of_maps_and_series(tmp_path):
    spiky = with_noise(record(seed=4, samples=100, runs=15, outlier_share=0.005, outlier_size=1e-3))
    result = fit(spiky, "stage31", solver="direct", holdout=HOLDOUT)
    text = document(page_content(spiky, result))
    (count,) = re.findall(r"Maps and series leave (\d+) isolated spikes out", text)
    (left_out,) = re.findall(r"(\d+) of \d+ samples .* are isolated spikes", " ".join(result.notes))
    assert int(count) == int(left_out)
    assert "show samples that the fit gave little" not in text
    rows = result.errors.rows()
    worst = max(max(rows[part]["peak"].values()) for part in ("fitted", "holdout"))
    for size in re.findall(r"fitted up to ([\d.e+]+) µ", text):
        assert float(size) < 1.01e6 * worst < 50


def test_a_page_reads_a_log_without_the_mistakes_that_its_fit_undid():
    columns = record(seed=5, runs=15)
    columns["hall_a_m"], columns["hall_b_m"] = columns["hall_b_m"], -columns["hall_a_m"]
    swapped = with_noise(columns)
    result = fit(
        swapped,
        "stage31",
        solver="direct",
        loss="none",
        corrections=["sign hall_b_m", "exchange hall_a_m hall_b_m"],
    )
    sizes = [
        float(v) for v in re.findall(r"fitted up to ([\d.e+]+) µ", document(page_content(swapped, result)))
    ]
    assert len(sizes) == 6  # in the first view, and to zoom
    assert max(sizes) < 20


def test_the_card_says_the_claims_of_a_fit(fitted: Fit, log: Log):
    claimed = fitted.changed(claims=(Claim("sign", "hall_a_m is inverted."),))
    said = page_content(log, claimed)
    assert said.state == "bad"
    assert "Claim: hall_a_m is inverted." in said.answer


def test_another_log_is_named_as_such_and_gets_its_own_zeros(fitted: Fit, log: Log):
    other = with_noise(record(seed=9, runs=15))
    page = document(page_content(other, fitted))
    text = Outline(page).text
    assert "This log is not the one that was fitted" in text
    assert "holdout" not in text.partition("Input")[2].partition("Parameters")[0]
    found = gather(other, fitted)  # zeros of the wrong log
    own = re.search(r"rmse, this log ([\d.]+) ", text)
    rmse = found.tables["decoded"].over()["rmse"]
    assert float(own[1]) < 1e6 * rmse["x_m"]
    assert float(own[1]) == pytest.approx(1e6 * fitted.noise_floor["x_m"], rel=0.05)


def test_a_log_without_time_counts_samples(log: Log):
    columns = {c: log.array(c)[log.array("run") < 15] for c in log.columns if c != "t_s"}
    bare = replace(Log.from_arrays(columns), noise=log.noise)
    text = document(page_content(bare, fit(bare, "stage31", solver="direct", loss="none")))
    assert "sample of the run" in text
    assert '"unit":"samples"' in text


# -- what is gathered ------------------------------------------------------------------------------------


def test_maps_count_every_sample_and_agree_with_the_error_table(log: Log, fitted: Fit):
    found = gather(log, fitted)
    (maps,), (table,) = found.maps.values(), found.tables.values()
    assert len([m for m in maps if m.up]) == 1
    assert [m.by for m in maps if not m.up] == ["x [µm]", "y [µm]", "Rz [µrad]"]
    for m in maps:
        assert m.count.sum() == log.rows
        squares = np.nansum(m.rms**2 * m.count, axis=1)
        np.testing.assert_allclose(squares, table.squares.sum(axis=0), rtol=1e-9)
    left = fitted.residuals(log)
    error = np.array([left[c][left["run"] == 2] for c in fitted.model.pose])
    np.testing.assert_allclose(table.squares[2], (error**2).sum(axis=1), rtol=1e-9)
    np.testing.assert_allclose(table.peak[2], np.abs(error).max(axis=1), rtol=1e-9)
    assert [a.get_xlabel() for a in draw(by_groups(fitted, found)[-1]).axes] == ["", "", "run"]


def test_gathering_does_not_depend_on_blocks(log: Log, fitted: Fit):
    whole = gather(log, fitted)
    pieces: Log = Chopped(log, (7, 1, 19))  # type: ignore[assignment]
    for name in ("columns", "runs", "table", "name"):
        setattr(pieces, name, getattr(log, name))
    parts = gather(pieces, fitted)
    for a, b in zip(whole.maps["decoded"], parts.maps["decoded"], strict=True):
        np.testing.assert_array_equal(a.count, b.count)
        np.testing.assert_allclose(a.mean, b.mean, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(a.rms, b.rms, rtol=1e-12)
    for a, b in zip(whole.series, parts.series, strict=True):
        assert a.title == b.title
        np.testing.assert_allclose(a.lines["decoded"], b.lines["decoded"], rtol=1e-9, atol=1e-18)


def test_an_axis_at_rest_shows_no_bias_at_the_middle(log: Log, fitted: Fit):
    """Runs that move y rest at x = 0 with noise of both signs, which must not decide the cell."""
    over_x = next(m for m in gather(log, fitted).maps["decoded"] if not m.up)
    middle = np.argmax(over_x.count)
    assert over_x.edges[middle] < 0 < over_x.edges[middle + 1]
    error = over_x.rms[:, middle] / math.sqrt(over_x.count[middle])
    assert np.all(np.abs(over_x.mean[:, middle]) < 5 * error)


# -- series ----------------------------------------------------------------------------------------------


def _points(path: str) -> list[list[tuple[int, int]]]:
    """Read a path back: pieces of points, in the path's own units."""
    x = y = 0
    pieces = []
    for piece in re.findall(r"m[^m]*", path):
        numbers = [int(n) for n in re.findall(r"-?\d+", piece)]
        pieces.append([])
        for dx, dy in zip(numbers[::2], numbers[1::2], strict=True):
            x, y = x + dx, y + dy
            pieces[-1].append((x, y))
    return pieces


def _first_run(series):
    return script_data([series])["runs"][0]


def test_a_series_keeps_its_peaks_and_gaps():
    time = np.linspace(5.0, 25.0, 50_000)
    error = 1e-6 * np.sin(time)[None] * np.ones((2, 1))
    error[0, 12_345] = 9e-6
    error[1, 30_000:31_000] = np.nan
    series = run_series("run 4", ("x_m", "rz_rad"), time, {"decoded": error})
    assert series.per_column == 32
    run = _first_run(series)
    first, second = map(_points, run["lines"][0])
    assert len(first) == 1
    assert len(second) == 2
    height = {y: x for x, y in first[0]}
    assert min(height) == -UP
    assert height[-UP] == pytest.approx(ACROSS * 12_345 / 50_000, abs=ACROSS / 1500)
    assert run["reach"][0] == 9
    assert run["to"] == pytest.approx(20, abs=0.02)
    assert sum(map(len, run["lines"][0])) < 60_000


def test_a_short_series_is_drawn_sample_by_sample():
    error = np.array([[1e-6, -2e-6, 0.5e-6]])
    series = run_series("run 0", ("x_m",), np.array([0.0, 0.1, 0.2]), {"a": error})
    (points,) = _points(_first_run(series)["lines"][0][0])
    assert points == [(0, -UP // 2), (ACROSS // 2, UP), (ACROSS, -UP // 4)]


def test_a_series_of_one_sample_or_none_kept_is_drawn():
    one = run_series("r", ("x_m",), np.array([3.0]), {"a": np.array([[1e-6]])})
    assert _first_run(one)["lines"][0][0]
    assert not _first_run(run_series("r", ("x_m",), None, {"a": np.full((1, 9), np.nan)}))["lines"][0][0]
    assert not shared.runs_section([]).content


def test_a_cell_of_few_samples_decides_no_map():
    counts, sizes = np.array([900, 800, 3]), np.array([[1e-6, 2e-6, 9e-6]])
    cells = Cells(
        "x [µm]", ("x_m",), counts, sizes, sizes, np.arange(4.0), up="y [µm]", across=np.arange(2.0)
    )
    assert plane(cells, [cells], "mean", 0, 0.0).title == "x, full: 2 µm"
    sparse = replace(cells, count=np.array([1, 1, 1]))
    assert plane(sparse, [sparse], "rms", 0, 0.0).title == "x, full: 9 µm"


# -- axes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize(("low", "high"), [(0.0123, 0.3), (1.19, 4.8), (2.0, 5e3), (1e-6, 70.0), (93.0, 1e7)])
def test_numbers_of_an_axis_are_few_round_inside_and_rising(low, high, log):
    panel = Panel(Axis(low=low, high=high, log=log), Axis(names=()), [])
    words = re.findall(r"<text[^>]*>([^<]*)</text>", svg(panel, 240.0).replace("\N{MINUS SIGN}", "-"))
    found = [float(word) for word in words]
    assert 2 <= len(found) <= 6
    assert found == sorted(set(found))
    assert low * 0.999 <= found[0] < found[-1] <= high * 1.001
    assert all(re.fullmatch(r"[0.]*[0-9]0*(\.0*)?|[0-9]e[-+]\d+|[0-9]+", f"{v:.10g}") for v in found)


@pytest.mark.parametrize("largest", [1.0, -0.00899, -0.0000899, 123456.0])
def test_the_title_beside_an_axis_is_inside_the_picture_whatever_its_numbers(largest):
    panel = Panel(Axis(names=()), Axis("title", *sorted((largest, 0.999 * largest))), [])
    at = re.search(r'<text x="([-\d.]+)"[^>]*>title<', svg(panel, 240.0))
    assert at
    assert float(at[1]) >= 10.0  # its letters are 11 px high and stand left of that


# -- runs, worst first ---------------------------------------------------------------------------------


def test_runs_are_offered_worst_first(log: Log, fitted: Fit):
    (table,) = gather(log, fitted).tables.values()
    order = worst_first(table, fitted.noise_floor, 60)
    assert sorted(order) == sorted(table.runs)
    floor = np.array(list(fitted.noise_floor.values()))
    rms = np.sqrt(table.squares / table.count[:, None])
    size = dict(zip(table.runs, (rms / floor).max(axis=1), strict=True))
    assert [size[run] for run in order] == sorted(size.values(), reverse=True)
    assert worst_first(table, {}, 2) == worst_first(table, {}, 60)[:2]
