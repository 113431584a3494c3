"""The documentation site: every public name has its page; it builds without a warning and works offline."""

import json
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import browser
import pytest

import hallsym

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
TUTORIALS = sorted(page.stem for page in DOCS.glob("tutorials/*.md") if page.stem != "index")


def test_every_public_name_is_in_the_reference():
    page = (DOCS / "reference" / "python.md").read_text(encoding="utf-8")
    listed = re.findall(r"^   (\w+)$", page, re.M)
    assert sorted(listed) == sorted(set(hallsym.__all__) - {"__version__"})


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site, built from a copy: the gallery and the reference write beside their sources."""
    pytest.importorskip("sphinx_gallery", reason="the extra `docs` is not installed")
    folder = tmp_path_factory.mktemp("site")
    ignored = shutil.ignore_patterns("examples", "generated")
    shutil.copytree(DOCS, folder / "docs", ignore=ignored)
    (folder / "data").symlink_to(ROOT / "data")
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-q", "-W", "--keep-going", "docs", "site"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    made = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=900)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert made.returncode == 0, made.stderr
    assert made.stderr == ""
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 180, "s of the processor"
    return folder / "site"


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_its_links_lead_somewhere(site):
    pages = [page for page in site.rglob("*.html") if "_static" not in page.parts]
    assert len(pages) > 60
    for page in pages:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r'(?:href|src)="([^"#?]+)', text):
            if re.match(r"[a-z]+:", target):
                assert target.startswith("https://"), f"{page.name}: {target}"
                continue
            assert (page.parent / target).exists(), f"{page.name} leads to {target}"


@pytest.mark.slow
def test_pages_are_read_without_a_network(site):
    """No script, style, font or picture comes from elsewhere."""
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert re.findall(r'<(?:script|img|iframe)[^>]+src="https?:', text) == [], page.name
        assert re.findall(r'<link[^>]+rel="stylesheet"[^>]+href="https?:', text) == [], page.name


@pytest.mark.slow
def test_the_gallery_shows_pictures(site):
    thumbnails = re.findall(r'<img[^>]+src="([^"]+thumb[^"]+)"', (site / "examples/index.html").read_text())
    assert len(thumbnails) >= 12
    for path in thumbnails:
        assert (site / "examples" / path).stat().st_size > 2_000


@pytest.mark.slow
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_is_a_notebook_that_has_run(site, name):
    page = (site / "tutorials" / f"{name}.html").read_text(encoding="utf-8")
    assert f'href="{name}.ipynb"' in page
    cells = json.loads((site / "tutorials" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    outputs = [output for cell in code for output in cell["outputs"]]
    assert all(cell["execution_count"] for cell in code)
    assert "error" not in {output["output_type"] for output in outputs}
    said = "".join("".join(output["text"]) for output in outputs if output.get("name") == "stderr")
    progress = re.compile(r"hallsym: .* s (left|so far)|")
    assert [line for line in said.splitlines() if not progress.fullmatch(line)] == []
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 1
    stated = ["".join(cell["source"]).count('|| echo "exit code $?"') for cell in code]
    codes = ["".join("".join(o.get("text", "")) for o in cell["outputs"]) for cell in code]
    assert [re.findall(r"^exit code (.*)$", text, re.M) for text in codes] == [["3"] * n for n in stated]


@pytest.fixture(scope="module")
def chromium(tmp_path_factory) -> browser.Browser:
    return browser.start(tmp_path_factory.mktemp("chromium"))


DARK = "--blink-settings=preferredColorScheme=0"
SHOWN = (
    "index", "tutorials/stage", "tutorials/encoder", "tutorials/controller", "tutorials/firmware",
    "examples/index",
)  # fmt: skip
SET = ("theory", "statistics", "encoder_model")


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SHOWN, *SET, "howto", "reference/python"])
def test_a_browser_finds_no_fault(site, chromium, name):
    seen = chromium.look(site / f"{name}.html", "--window-size=1300,900")
    assert faults_of(seen) == []
    assert (seen["pictures"] > 0) == (name in SHOWN)
    assert (seen["formulas"] > 4) == (name in SET)
    assert seen["background"] == "rgb(255, 255, 255)"


@pytest.mark.slow
def test_a_page_is_whole_on_a_phone_in_the_dark(site, chromium):
    for page in [*sorted(site.glob("*.html"))[::4], *site.glob("tutorials/*.html")]:
        seen = chromium.look(page, "--window-size=500,900", DARK)
        assert faults_of(seen) == [], page.name
        red = int(re.findall(r"\d+", seen["background"])[0])
        assert red < 60, page.name


def faults_of(seen: dict[str, Any]) -> list[str]:
    """Errors of the console, pictures that are missing or have no words, formulas that are not set."""
    wide = ["wider than the window"] if seen["beyond"] > 0 else []
    unset = ["a formula is not set"] if seen["unset"] else []
    return seen["faults"] + seen["broken"] + seen["nameless"] + wide + unset


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "page"),
    [
        ("whiteness", "statistics.html"),
        ("controller", "controller.html"),
        ("lookup+table", "rotary.html"),
        ("stepper", "tables.html"),
        ("interferometer", "tutorials/stage.html"),
    ],
)
def test_the_search_works_from_a_file(site, chromium, words, page):
    seen = chromium.look(site / "search.html", query=f"?q={words}")
    assert seen["faults"] == []
    assert page in [link.partition("?")[0].partition("#")[0] for link in seen["results"]]
