"""Chromium without a window, for tests that look at pages."""

import json
import os
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")


class Browser:
    def __init__(self, program: str, home: Path) -> None:
        self.program, self.home = program, home

    def run(self, page: Path, *options: str, query: str = "") -> str:
        command = [
            self.program, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
            f"--user-data-dir={self.home}", *options, page.as_uri() + query,
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout

    def dom(self, page: Path, *options: str) -> str:
        return self.run(page, "--dump-dom", *options)

    def framed(self, page: Path, width: int, script: str, *options: str) -> str:
        """Return what `script` tells by `tell(text)`, at once or later, in the page framed `width` px wide.

        A window cannot be as narrow as a phone, a frame can. The page's own policy would forbid the script.
        """
        text = page.read_text(encoding="utf-8")
        head, _, rest = text.partition('<meta http-equiv="Content-Security-Policy"')
        tell = "const tell = (text) => parent.postMessage(text, '*');"
        inside = rest[rest.index(">") + 1 :].replace("</body>", f"<script>{tell}{script}</script></body>")
        page.with_name("inside.html").write_text(head + inside, encoding="utf-8")
        frame = page.with_name("frame.html")
        frame.write_text(
            f"<!doctype html><iframe src=inside.html width={width} height=1500></iframe><script>"
            "addEventListener('message',"
            " (e) => { document.body.textContent = 'answer:' + e.data + ':end'; });</script>"
        )
        found = self.dom(frame, "--window-size=1300,1600", "--virtual-time-budget=20000", *options)
        return unescape(found.partition("answer:")[2].partition(":end")[0])

    def ask(self, page: Path, expression: str, *options: str) -> str:
        """Return what a JavaScript expression gives in the page, whose own policy would forbid to ask."""
        text = page.read_text(encoding="utf-8")
        policy, _, rest = text.partition('<meta http-equiv="Content-Security-Policy"')
        asked = page.with_name("asked.html")
        script = f"<script>document.body.innerHTML = 'answer:' + ({expression}) + ':end';</script>"
        asked.write_text(policy + rest[rest.index(">") + 1 :].replace("</body>", f"{script}</body>"))
        return self.dom(asked, *options).partition("answer:")[2].partition(":end")[0]

    def look(self, page: Path, *options: str, query: str = "") -> dict[str, Any]:
        """Return what a page shows once it has loaded: faults, pictures, formulas, results of a search."""
        text = page.read_text(encoding="utf-8")
        looked = page.with_name("looked.html")
        before, head, rest = text.partition("<head>")
        looked.write_text(before + head + WATCH + rest.replace("</body>", f"{LOOK}</body>"), encoding="utf-8")
        seen = self.run(looked, "--dump-dom", "--virtual-time-budget=20000", *options, query=query)
        looked.unlink()
        found: dict[str, Any] = json.loads(unquote(seen.partition("answer:")[2].partition(":end")[0]))
        return found


WATCH = """<script>
const faults = [], error = console.error;
console.error = (...words) => faults.push(words.join(" "));
addEventListener("unhandledrejection", (e) => faults.push(String(e.reason)));
const fault = (e) => e.message || `cannot load ${e.target.src || e.target.href}`;
addEventListener("error", (e) => faults.push(fault(e)), true);
const hurry = () => document.querySelectorAll("img").forEach((i) => (i.loading = "eager"));
addEventListener("DOMContentLoaded", hurry);
</script>"""
LOOK = """<script>
addEventListener("load", () => setTimeout(() => {
  const all = (what) => [...document.querySelectorAll(what)];
  const pictures = all("main img");
  const seen = {
    faults,
    pictures: pictures.length,
    broken: pictures.filter((i) => !i.complete || !i.naturalWidth).map((i) => i.src),
    nameless: pictures.filter((i) => !i.alt && !i.closest(".sphx-glr-thumbcontainer")).map((i) => i.src),
    formulas: all("mjx-container").length,
    unset: all("mjx-merror").length,
    results: all("#search-results li a").map((a) => a.getAttribute("href")),
    beyond: document.documentElement.scrollWidth - innerWidth,
    background: getComputedStyle(document.body).backgroundColor,
  };
  document.body.textContent = "answer:" + encodeURIComponent(JSON.stringify(seen)) + ":end";
}, 4000));
</script>"""


def start(home: Path) -> Browser:
    """Skip where there is no browser, except in continuous integration, which has to have one."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        if os.environ.get("CI") == "true":
            pytest.fail("continuous integration needs chromium: apt-get install chromium")
        pytest.skip("no chromium on this machine (Debian: apt-get install chromium)")
    return Browser(program, home)
