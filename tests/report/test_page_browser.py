"""Pages in Chromium: the script runs, nothing overlaps, nothing is asked of a network, it prints."""

import json
import re
from pathlib import Path

import browser
import numpy as np
import pytest
from matplotlib.image import imread
from test_page import HOLDOUT
from test_page_diagnosis import POSE, a_record, page_of
from twins import record, with_noise

from hallsym.estimation import fit
from hallsym.report.data import gather, run_series
from hallsym.report.page import fit_page

OVERLAPS = """
JSON.stringify({ across: document.documentElement.scrollWidth - document.documentElement.clientWidth,
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
    [...figure.querySelector('.ticksx').querySelectorAll('text')].map((t) => t.textContent)];
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


@pytest.fixture(scope="module")
def chromium(tmp_path_factory) -> browser.Browser:
    return browser.start(tmp_path_factory.mktemp("chromium"))


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> dict[str, Path]:
    """Pages of a fit, of a fit with many settings and names, and of a diagnosis."""
    folder = tmp_path_factory.mktemp("pages")
    log = with_noise(record(seed=1))
    fitted = fit(log, "stage31", solver="direct", loss="none", holdout=HOLDOUT)
    t = np.linspace(0, 20, 40_000)
    noise = np.random.default_rng(0).standard_normal((3, t.size))
    errors = {"before": 3e-6 * np.sin(2 * t) + 1e-6 * noise, "after": 1e-6 * noise}
    found = gather(log, fitted, label="before")
    series = [run_series("run 2, held out", POSE, t, errors)]
    wordy = a_record()
    wordy["effects"][0]["name"] = wordy["where"][0]["by"] = "a_long_name_of_an_effect_that_a_user_wrote" * 3
    texts = {
        "fit": fit_page(log, fitted, command="hallsym report calib.json log.csv"),
        "diagnosis": page_of(wordy, maps=found.maps, after=found.maps, series=series, fit=fitted),
    }
    for name, text in texts.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    return {name: folder / f"{name}.html" for name in texts}


@pytest.mark.parametrize("name", ["fit", "diagnosis"])
def test_the_script_runs_under_its_own_policy(chromium, pages, name):
    shown = chromium.dom(pages[name])
    figures = shown.count('<figure class="series"')
    assert figures == (3 if name == "fit" else 1)
    assert shown.count('<div class="zoom">') == figures
    assert shown.count('<button type="button"') == 5 * figures
    assert '<p class="verdict"' in shown
    if name == "diagnosis":
        for part in ("asked", "errors", "effects", "where", "rest", "maps", "series", "parameters", "origin"):
            assert f'<section id="{part}">' in shown
        assert shown.count('<figure class="shape">') == 1
        assert shown.count('class="median0"') > 20  # before, under after


def test_a_script_that_is_not_its_own_is_refused_and_the_charts_stay_without_it(chromium, pages, tmp_path):
    changed = tmp_path / "changed.html"
    text = pages["fit"].read_text(encoding="utf-8")
    changed.write_text(text.replace('"use strict";', '"use strict"; document.title = "changed";'))
    shown = chromium.dom(changed)
    assert "<title>changed" not in shown
    assert "<button" not in shown
    assert len(re.findall(r'<path d="m[^"]{300,}" class="line line0">', shown)) == 9


@pytest.mark.parametrize("name", ["fit", "diagnosis"])
@pytest.mark.parametrize("width", [500, 1100])
def test_no_label_overlaps_or_is_cut_off_and_the_page_does_not_scroll_sideways(chromium, pages, name, width):
    answer = json.loads(chromium.ask(pages[name], OVERLAPS, f"--window-size={width},900"))
    assert answer["labels"] > 100
    assert answer["overlaps"] == []
    assert answer["across"] <= 0


def test_buttons_keys_and_mouse_zoom(chromium, pages):
    answer = chromium.ask(pages["diagnosis"], ZOOM, "--window-size=1100,900")
    start, halved, moved, out, dragged, all_ = json.loads(answer.replace("&gt;", ">"))
    assert start[1] == ""
    assert (halved[0][0], halved[0][2]) == (5000, 10000)
    assert re.fullmatch(r"4\.99\d* to 14\.99 s", halved[1])
    assert halved[2] == ["6", "8", "10", "12", "14"]
    assert (moved[0][0], moved[0][2]) == (9000, 10000)
    assert (out[0][0], out[0][2]) == (0, 20000)
    left, width = 46 / 740, (740 - 46 - 8) / 740
    first, last = ((part - left) / width * 20000 for part in (0.3, 0.5))
    assert dragged[0][0] == pytest.approx(first, abs=30)
    assert dragged[0][2] == pytest.approx(last - first, abs=30)
    assert dragged[0][3] <= start[0][3]
    assert (all_[0][0], all_[0][2]) == (0, 20000)
    assert all_[0] == start[0]
    assert all_[2] == start[2]


@pytest.mark.parametrize("name", ["fit", pytest.param("diagnosis", marks=pytest.mark.slow)])
def test_a_screenshot_shows_the_page_on_white(chromium, pages, name, tmp_path):
    chromium.run(pages[name], "--window-size=1000,2400", f"--screenshot={tmp_path / 'page.png'}")
    pixels = imread(tmp_path / "page.png")[..., :3]
    assert pixels.shape == (2400, 1000, 3)
    light = (pixels.min(axis=2) > 0.93).mean()
    assert 0.7 < light < 0.98
    assert (pixels.max(axis=2) < 0.3).mean() > 0.005  # words and axes
    for band in np.array_split(pixels, 8):
        assert (band.min(axis=2) < 0.5).any(), "an empty stretch"


@pytest.mark.parametrize("name", ["fit", pytest.param("diagnosis", marks=pytest.mark.slow)])
def test_print_has_vectors_only_and_few_pages(chromium, pages, name, tmp_path):
    chromium.run(pages[name], "--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'page.pdf'}")
    pdf = (tmp_path / "page.pdf").read_bytes()
    assert pdf.startswith(b"%PDF")
    assert not re.search(rb"/Subtype\s*/Image", pdf)
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 12
