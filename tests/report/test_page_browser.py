"""Pages in Chromium: the script runs, nothing overlaps, nothing is asked of a network, it prints."""

import json
import re
from dataclasses import replace
from pathlib import Path

import browser
import numpy as np
import pytest
from reports import run_series
from test_page_diagnosis import POSE, a_record, page_of

from hallsym.report.content import document
from hallsym.report.data.gather import gather
from hallsym.report.panels import by_groups
from hallsym.report.results.fit import page_content

OVERLAPS = """JSON.stringify({
  across: document.documentElement.scrollWidth - document.documentElement.clientWidth,
  cut: [...document.querySelectorAll('.wide, .scroll')].filter((e) => e.scrollWidth > e.clientWidth + 1)
    .map((e) => e.getAttribute('aria-label')),
  labels: document.querySelectorAll('svg text').length,
  overlaps: [...document.querySelectorAll('svg')].flatMap((svg) => {
  const boxes = [...svg.querySelectorAll('text')].map((t) => [t.textContent, t.getBoundingClientRect()]);
  const frame = svg.getBoundingClientRect();
  return boxes.flatMap(([a, p], i) => [
    ...boxes.slice(i + 1).filter(([, q]) => Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1
      && Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 2).map(([b]) => a + ' | ' + b),
    ...(p.left < frame.left - 1 || p.right > frame.right + 1 ? [a + ' is cut off'] : []),
  ]);
}) })
"""
ZOOM = """
(() => {
  const figure = document.querySelector('figure.series'), view = figure.querySelector('.view');
  const state = () => [view.getAttribute('viewBox').split(' ').map(Number),
    figure.querySelector('output').textContent,
    [...figure.querySelector('.across').querySelectorAll('text')].map((t) => t.textContent)];
  const press = (key) => figure.dispatchEvent(
    new KeyboardEvent('keydown', { key, bubbles: true, cancelable: true }));
  const seen = [state()];
  figure.querySelector('.zoom button').click(); seen.push(state());
  press('ArrowRight'); seen.push(state());
  press('-'); press('-'); seen.push(state());
  const svg = figure.querySelector('svg.panel'), box = svg.getBoundingClientRect();
  const point = (type, part) => svg.dispatchEvent(new PointerEvent(type, {
    pointerType: 'mouse', button: 0, pointerId: 1, bubbles: true,
    clientX: box.left + box.width * part, clientY: box.top + 60 }));
  svg.setPointerCapture = () => {};
  point('pointerdown', 0.3); point('pointermove', 0.4); point('pointerup', 0.5); seen.push(state());
  press('0'); seen.push(state());
  return JSON.stringify(seen);
})()
"""
DO = """
(() => {
  const out = {}, figure = document.querySelector('figure.series'), pick = figure.querySelector('select');
  const path = () => figure.querySelector('.view path').getAttribute('d');
  const title = figure.querySelector('.run');
  const change = (select, k) => { select.selectedIndex = k; select.dispatchEvent(new Event('change')); };
  out.runs = pick.options.length; out.worst = title.textContent; out.first = pick.options[0].textContent;
  const before = path();
  change(pick, 1); out.picked = title.textContent; out.moved = path() !== before;
  const svg = figure.querySelector('svg.panel'), box = svg.getBoundingClientRect();
  const point = (type) => svg.dispatchEvent(new PointerEvent(type, { pointerType: 'mouse', bubbles: true,
    clientX: box.left + box.width * 0.5, clientY: box.top + 60 }));
  const cursors = () => [...figure.querySelectorAll('.cursor')].map((c) => c.getAttribute('d'));
  point('pointermove'); out.hover = figure.querySelector('.readout').textContent;
  out.cursors = cursors().filter(Boolean).length;
  point('pointerleave'); out.left = cursors();
  const table = document.querySelector('table.sortable'), head = table.tHead.rows[0].cells[0];
  const names = () => [...table.tBodies[0].rows].map((r) => r.cells[0].textContent);
  out.sorted = []; out.aria = [];
  for (let k = 0; k < 2; k++) {
    head.querySelector('button').click(); out.sorted.push(names());
    out.aria.push(head.getAttribute('aria-sort'));
  }
  out.command = document.querySelector('.next pre').textContent;
  out.button = document.querySelector('.next button').textContent;
  return JSON.stringify(out);
})()
"""


@pytest.fixture(scope="module")
def chromium(tmp_path_factory) -> browser.Browser:
    return browser.start(tmp_path_factory.mktemp("chromium"))


@pytest.fixture(scope="module")
def pages(tmp_path_factory, log, fitted) -> dict[str, Path]:
    """Pages of a fit, of a fit with many settings and names, and of a diagnosis."""
    folder = tmp_path_factory.mktemp("pages")
    t = np.linspace(0, 20, 40_000)
    noise = np.random.default_rng(0).standard_normal((3, t.size))
    errors = {"before": 3e-6 * np.sin(2 * t) + 1e-6 * noise, "after": 1e-6 * noise}
    found = gather(log, fitted, label="before")
    series = [run_series("run 2, holdout", POSE, t, errors)]
    wordy = a_record()
    wordy["effects"][0]["name"] = wordy["where"][0]["by"] = "a_long_name_of_an_effect_that_a_user_wrote" * 3
    twice, tables = (
        dict.fromkeys(("before", "after"), each["before"]) for each in (found.maps, found.tables)
    )
    groups = by_groups(fitted, replace(found, tables=tables))
    texts = {
        "fit": document(page_content(log, fitted, command="hallsym report calib.json log.csv")),
        "diagnosis": page_of(wordy, maps=twice, groups=groups, series=series, fit=fitted),
    }
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return {name: folder / f"{name}.html" for name in texts}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fit", "diagnosis"])
def test_the_script_runs_under_its_own_policy(chromium, pages, name):
    shown = chromium.dom(pages[name])
    figures = shown.count('<figure class="series"')
    assert figures == 1
    assert shown.count('<div class="zoom">') == 1
    assert shown.count('<span class="readout">') == 1
    assert "(worst)" in shown or name == "diagnosis"
    for button in ("+", "all", "parameter", *(["copy"] if name == "fit" else [])):
        assert f">{button}</button>" in shown, button
    assert '<p class="verdict"' in shown
    if name == "diagnosis":
        for part in ("asked", "errors", "effects", "where", "rest", "maps", "series", "parameters", "origin"):
            assert f'<section id="{part}">' in shown
        assert shown.count("line with its 95&nbsp;% band") == 1
        assert shown.count('stroke="var(--median0)"') == 15  # before, over time and along coordinates


@pytest.mark.slow
def test_a_script_that_is_not_its_own_is_refused_and_the_charts_stay_without_it(chromium, pages, tmp_path):
    changed = tmp_path / "changed.html"
    text = pages["fit"].read_text(encoding="utf-8")
    changed.write_text(text.replace('"use strict";', '"use strict"; document.title = "changed";'))
    shown = chromium.dom(changed)
    assert "<title>changed" not in shown
    assert "<button" not in shown
    over_time = shown.partition('<figure class="series"')[2]
    assert len(re.findall(r'<path d="M[^"]{300,}" fill="none" stroke="var\(--edge\)"', over_time)) == 3


@pytest.mark.slow
@pytest.mark.parametrize(("name", "width"), [("fit", 390), ("diagnosis", 1100)])
def test_no_label_overlaps_or_is_cut_off_and_the_page_does_not_scroll_sideways(chromium, pages, name, width):
    answer = json.loads(chromium.framed(pages[name], width, f"tell({OVERLAPS})"))
    assert answer["labels"] > 100
    assert answer["overlaps"] == []
    assert answer["across"] <= 0
    assert width > 390 or answer["cut"] == []  # a wide window may leave a wide table to scroll


@pytest.mark.slow
def test_buttons_keys_and_mouse_zoom(chromium, pages):
    answer = chromium.ask(pages["diagnosis"], ZOOM, "--window-size=1100,900")
    start, halved, moved, out, dragged, all_ = json.loads(answer.replace("&gt;", ">"))
    assert start[1] == ""
    assert (halved[0][0], halved[0][2]) == (5000, 10000)
    assert re.fullmatch(r"4\.99\d* to 14\.99 s", halved[1])
    assert halved[2] == ["6", "8", "10", "12", "14"]
    assert (moved[0][0], moved[0][2]) == (9000, 10000)
    assert (out[0][0], out[0][2]) == (0, 20000)
    left, width = 54 / 740, (740 - 54 - 14) / 740
    first, last = ((part - left) / width * 20000 for part in (0.3, 0.5))
    assert dragged[0][0] == pytest.approx(first, abs=30)
    assert dragged[0][2] == pytest.approx(last - first, abs=30)
    assert dragged[0][3] <= start[0][3]
    assert (all_[0][0], all_[0][2]) == (0, 20000)
    assert all_[0] == start[0]
    assert all_[2] == start[2]


@pytest.mark.slow
def test_picker_hover_sorting_and_copying(chromium, pages):
    """What can be done on a page besides zooming, in one go: a browser takes long to start."""
    found = json.loads(chromium.ask(pages["fit"], DO, "--window-size=1100,900").replace("&gt;", ">"))
    assert found["runs"] == 20
    assert found["first"].startswith(found["worst"])
    assert found["picked"] != found["first"]
    assert found["moved"]
    assert re.fullmatch(r"at 0\.\S+ s: x \S+ µm; y \S+ µm; Rz \S+ µrad", found["hover"])
    assert found["cursors"] == 3
    assert found["left"] == ["", "", ""]
    ordered = found["sorted"]
    assert ordered[0] == sorted(ordered[0], key=str.lower)
    assert ordered[1] == ordered[0][::-1]
    assert found["aria"] == ["ascending", "descending"]
    assert found["command"].startswith("hallsym ")
    assert found["button"] == "copy"


A4 = 688
"""Width of an A4 page within its margins of 14 mm [px]."""
AUDIT = """axe.run(document, { resultTypes: ['violations'] }).then((found) => tell(JSON.stringify(
  found.violations.map((v) => [v.id, v.help, v.nodes.slice(0, 3).map((n) => n.html.slice(0, 200))]))),
  (error) => tell(String(error)))"""


@pytest.fixture(scope="module")
def axe() -> str:
    package = pytest.importorskip("axe_core_python", reason="axe-core-python is not installed")
    script = Path(package.__file__).with_name("axe.min.js").read_text(encoding="utf-8")
    return script.replace("</script>", "<\\/script>")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "width", "dark"), [("fit", 1100, True), ("diagnosis", 390, False)])
def test_axe_finds_nothing(chromium, pages, axe, name, width, dark):
    scheme = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    answer = chromium.framed(pages[name], width, axe + ";" + AUDIT, scheme)
    assert json.loads(answer) == []


@pytest.mark.slow
def test_axe_finds_nothing_on_paper(chromium, pages, axe, tmp_path):
    """Chromium has no option for the media type, so the rules for print are made those of the window."""
    text = pages["diagnosis"].read_text(encoding="utf-8")
    for media, instead in (("@media print", "@media all"), ("@media screen", "@media print")):
        assert media in text
        text = text.replace(media, instead)
    printed = tmp_path / "printed.html"
    printed.write_text(text, encoding="utf-8")
    shown = "getComputedStyle(document.querySelector('nav')).display === 'none'"
    answer = chromium.framed(printed, A4, f"{axe};if ({shown}) {AUDIT}; else tell('shown as on a screen')")
    assert json.loads(answer) == []


@pytest.mark.slow
def test_print_has_vectors_only_and_few_pages(chromium, pages, tmp_path):
    chromium.run(pages["fit"], "--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'page.pdf'}")
    pdf = (tmp_path / "page.pdf").read_bytes()
    assert pdf.startswith(b"%PDF")
    assert not re.search(rb"/Subtype\s*/Image", pdf)
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 12
