"""Every example in README.md and docs/ runs; every command, option, link and file that they name exists.

Blocks of one page run in order in one temporary folder, in which `data` is the repository's. ```python runs;
```sh runs line by line: `hallsym ...` through the installed entry point, `make` and `pip` are only looked up.
A ```toml or ```json block is written to the last `file` named before it. `<!--setup ... -->` is Python that a
reader does not need. A comment `# exit 3` states the exit code that is expected, 0 otherwise.

The tutorials are notebooks, which run where the site is built (tests/test_site.py): cells of Python, of shell
commands (`%%sh`; `|| echo` where the exit code shall be 3) and files to write (`%%writefile`).
"""

import contextlib
import io
import json
import re
import shlex
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from hallsym.cli import COMMANDS

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = tuple(sorted((ROOT / "docs" / "tutorials").glob("*.md")))
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *TUTORIALS)
LISTED = (
    "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "data/README.md", "data/campaign/README.md",
    "data/encoder/README.md",
)  # fmt: skip
LONG = {
    "README", "budget", "campaign", "codegen", "concepts", "controller", "diagnose", "evaluate", "extend",
    "fleet", "halbach", "howto", "logs", "plan", "power", "python", "report", "rotary", "self_calibration",
    "sensitivity", "sorting", "tables", "tolerances", "trajectory",
}  # fmt: skip
"""Pages whose examples take more than a second of a processor: they run with the slow tests; what they name
is always looked up."""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@dataclass(frozen=True)
class Block:
    """A fenced block: language, text, line it begins at, and the last `file` named before it."""

    kind: str
    text: str
    line: int
    name: str


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def blocks_of(page: Path) -> Iterator[Block]:
    text = text_of(page)
    fence = r"^```(?:\{code-cell\} )?(\w+)\n(?:---\n.*?^---\n)?(.*?)^```$"
    for match in re.finditer(rf"{fence}|^<!--(setup)\n(.*?)^-->$", text, re.M | re.S):
        before = re.findall(r"`([\w./-]+\.(?:toml|json))`", text[: match.start()])
        yield Block(
            match[1] or match[3],
            match[2] or match[4] or "",
            text[: match.start()].count("\n") + 1,
            before[-1] if before else "",
        )


def lines_of(text: str) -> list[str]:
    """The commands of a block, continued lines joined."""
    return list(filter(None, map(str.strip, text.replace("\\\n", " ").splitlines())))


def commands_of(page: Path) -> Iterator[tuple[str, int, int]]:
    """Each command with the exit code it shall have and its line; of a notebook without what follows it."""
    for block in blocks_of(page):
        if block.kind in ("sh", "console"):
            for line in lines_of(block.text):
                command, _, remark = line.removeprefix("$ ").partition(" #")
                stated = re.search(r"exit (\d)", remark)
                yield command.strip(), int(stated[1]) if stated else 0, block.line
        elif block.text.startswith("%%sh\n"):
            for line in lines_of(block.text)[1:]:
                yield re.split(r" (?:>|\|\|?) ", line)[0], 0, block.line


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def hallsym(words: list[str]) -> tuple[int, str]:
    """Run the installed entry point; returns exit code and what it printed."""
    (point,) = entry_points(group="console_scripts", name="hallsym")
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = point.load()(words)
        except SystemExit as end:
            code = int(end.code or 0)
    return code, out.getvalue() + err.getvalue()


def run(command: str, expected: int) -> None:
    words = shlex.split(command)
    target = None
    if ">" in words:
        at = words.index(">")
        words, target = words[:at], words[at + 1]
    program, *arguments = words
    if Path(program).name == "hallsym":
        code, said = hallsym(arguments)
        assert code == expected, f"{command}: exit code {code}\n{said}"
        if target:
            Path(target).write_text(said, encoding="utf-8")
    elif program == "make":
        folder = Path(arguments[1]) if arguments[:1] == ["-C"] else ROOT
        arguments = arguments if folder == ROOT else arguments[2:]
        known = re.findall(r"^([a-z]+):", text_of(folder / "Makefile"), re.M)
        assert [a for a in arguments if "=" not in a and a not in known] == [], command
    elif program == "pip":
        extras = re.search(r"\[(.*)\]", command)
        wanted = extras[1].split(",") if extras else []
        assert set(wanted) <= set(PROJECT["optional-dependencies"]), command
    elif program in ("sed", "head"):
        subprocess.run(command, shell=True, capture_output=True, check=True)
    elif Path(program).name == "python":
        script = ROOT / arguments[0]
        assert script.is_file(), command
        for option in re.findall(r"--[a-z-]+", command):
            assert f'"{option}"' in text_of(script), f"{script} has no option {option}"
    else:
        pytest.fail(f"do not know how to check {command!r}")


def compiles(code: str, folder: Path) -> None:
    """Compile a C example against the folders that the page generated; nothing to do without a compiler."""
    if compiler := shutil.which("gcc"):
        paths = [f"-I{path.parent}" for path in folder.glob("*/*_params.h")]
        command = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", *paths, "-fsyntax-only", "-xc", "-"]
        found = subprocess.run(command, input=code, capture_output=True, text=True)
        assert found.returncode == 0, found.stderr


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.slow] if page.stem in LONG else [], id=name_of(page))
        for page in PAGES
        if page not in TUTORIALS
    ],
)
def test_examples_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").symlink_to(ROOT / "data")
    shared: dict = {"__name__": "example"}
    for block in blocks_of(page):
        where = f"{name_of(page)}, line {block.line}"
        if block.kind in ("python", "setup"):
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile("\n" * block.line + block.text, str(page), "exec"), shared)
        elif block.kind in ("sh", "console"):
            for command, expected, line in commands_of(page):
                if line == block.line:
                    run(command, expected)
        elif block.kind in ("toml", "json"):
            assert block.name.endswith(block.kind), f"{where}: no file name before the block"
            (tomllib if block.kind == "toml" else json).loads(block.text)
            Path(block.name).parent.mkdir(exist_ok=True)
            Path(block.name).write_text(block.text, encoding="utf-8")
        elif block.kind == "c":
            compiles(block.text, tmp_path)
        else:
            assert block.kind in ("text", "math"), f"{where}: a block of {block.kind} is not checked"


@pytest.mark.parametrize("page", [ROOT / name for name in LISTED] + list(PAGES[1:]), ids=name_of)
def test_links_and_files_exist(page):
    text = re.sub(r"^```.*?^```$", "", text_of(page), flags=re.M | re.S)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", link):
            assert link.startswith("https://"), link
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file) if file else page
        assert target.exists(), f"{name_of(page)} links to {link}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", text_of(target), re.M)
            assert anchor in {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in headings}, link
    for file in re.findall(r"`((?:hallsym|solvers|data|docs|tests)/[\w./-]+)`", text):
        assert (ROOT / file).exists(), f"{name_of(page)} names {file}"


@cache
def helps() -> dict[str, str]:
    texts = {}
    for command in ("", *COMMANDS):
        code, texts[command] = hallsym([*command.split(), "--help"])
        assert code == 0
    return texts


def test_every_command_has_help_and_is_documented():
    texts = helps()
    listed = texts[""].partition("calibrate:")[2].partition("options:")[0]
    found = re.findall(r"^  (\w+) +\w", listed, re.M)
    assert sorted(found) == sorted(COMMANDS)
    everything = "".join(map(text_of, PAGES))
    for command in COMMANDS:
        assert len(texts[command]) > 200, command
        assert re.search(rf"hallsym {command}\b", everything) or f"make {command}" in everything, command


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_and_options_exist(page):
    texts = helps()
    shown = [command for command, _, _ in commands_of(page)]
    shown += re.findall(r"`(hallsym [^`]*)`", text_of(page))
    for command in shown:
        words = shlex.split(command)
        if Path(words[0]).name != "hallsym" or len(words) == 1:
            continue
        name = "" if words[1].startswith("-") else words[1]
        assert name in texts, f"{name_of(page)}: hallsym has no command {name}"
        for option in (w for w in words[1:] if w.startswith("-")):
            assert re.search(rf"(^|[\s\[]){re.escape(option)}\b", texts[name]), (
                f"{command}: no option {option}"
            )
    inline = re.findall(r"`(--[a-z][a-z-]*)", text_of(page))
    for option in inline:
        assert any(re.search(rf"(^|[\s\[]){option}\b", text) for text in texts.values()), (
            f"{name_of(page)}: no command has the option {option}"
        )


def test_the_checks_of_a_log_say_what_the_page_quotes():
    source = "".join(text_of(file) for file in sorted((ROOT / "hallsym").rglob("*.py")))
    page = text_of(ROOT / "docs" / "logs.md").partition("## Checks")[2]
    quoted = re.findall(r'"([^"]+)"', re.split("```|<!--", page)[0])
    assert len(quoted) > 10
    for phrase in quoted:
        # numbers stand for what is formatted in; a sentence may be broken over lines of source
        pieces = [piece.strip() for piece in re.split(r"\d+(?: %)?", phrase)]
        joined = re.sub(r'"\s*\n\s*f?"', "", source)
        assert all(piece in joined for piece in pieces), phrase
