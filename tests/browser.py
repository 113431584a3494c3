"""Chromium without a window, for tests that look at pages."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")


class Browser:
    def __init__(self, program: str, home: Path) -> None:
        self.program, self.home = program, home

    def run(self, page: Path, *options: str) -> str:
        command = [
            self.program, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
            f"--user-data-dir={self.home}", *options, page.as_uri(),
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout

    def dom(self, page: Path, *options: str) -> str:
        return self.run(page, "--dump-dom", *options)

    def ask(self, page: Path, expression: str, *options: str) -> str:
        """Return what a JavaScript expression gives in the page, whose own policy would forbid to ask."""
        text = page.read_text(encoding="utf-8")
        policy, _, rest = text.partition('<meta http-equiv="Content-Security-Policy"')
        asked = page.with_name("asked.html")
        script = f"<script>document.body.innerHTML = 'answer:' + ({expression}) + ':end';</script>"
        asked.write_text(policy + rest[rest.index(">") + 1 :].replace("</body>", f"{script}</body>"))
        return self.dom(asked, *options).partition("answer:")[2].partition(":end")[0]


def start(home: Path) -> Browser:
    """Skip where there is no browser, except in continuous integration, which has to have one."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        if os.environ.get("CI") == "true":
            pytest.fail("continuous integration needs chromium: apt-get install chromium")
        pytest.skip("no chromium on this machine (Debian: apt-get install chromium)")
    return Browser(program, home)
