"""The house: imports go one way, there are no circles, names stand where they belong."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "cli", "report", "fleets", "power", "diagnosis", "codegen", "experiment", "sorting", "uncertainty",
    "inference", "estimation", "simulation", "trajectory", "families", "log", "model",
)  # fmt: skip
"""From the top down: a package imports those that stand after it, and what is flat (errors, units, files)."""
FAMILY_NAMES = re.compile(r"rotary|stage|encoder|halbach")


def modules() -> dict[str, Path]:
    """Return every module of hallsym and solvers by its dotted name."""
    found = {}
    for path in [*ROOT.glob("hallsym/**/*.py"), *ROOT.glob("solvers/**/*.py")]:
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


@cache
def read(name: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return the modules that a module imports and its names of families, functions and types included.

    Names that belong to one family are those of its code: what is said to people does not count.
    """
    out, words = set(), set()
    for node in ast.walk(ast.parse(MODULES[name].read_text(encoding="utf-8"))):
        match node:
            case ast.ImportFrom(module=str(module)):
                wholes = {f"{module}.{alias.name}" for alias in node.names}
                out |= {whole if whole in MODULES else module for whole in wholes}
                words.add(module)
            case ast.Import():
                out |= {alias.name for alias in node.names}
            case ast.Name(id=word) | ast.Attribute(attr=word) | ast.arg(arg=word) | ast.alias(name=word):
                words.add(word)
            case ast.FunctionDef(name=word) | ast.ClassDef(name=word):
                words.add(word)
            case ast.Compare():
                words |= {str(c.value) for c in ast.walk(node) if isinstance(c, ast.Constant)}
    house = frozenset(m for m in out if m in MODULES and m != name)
    return house, frozenset(word for word in words if FAMILY_NAMES.search(word))


def imported(name: str) -> frozenset[str]:
    """Return the modules of the house that a module imports."""
    return read(name)[0]


def package(name: str) -> str | None:
    """Return the package of a module of hallsym; None for what is flat."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in PACKAGES else None


SHARED = sorted(name for name in MODULES if name not in ("hallsym", "hallsym.__main__"))


def test_imports_go_one_way() -> None:
    wrong = []
    for name in SHARED:
        own = package(name)
        for other in imported(name):
            theirs = package(other)
            up = own is None or PACKAGES.index(own) > PACKAGES.index(theirs) if theirs else False
            if theirs != own and up:  # what is flat, and the solvers, know no package
                wrong.append(f"{name} imports {other}")
    assert wrong == []


def test_no_circle_of_modules() -> None:
    graph = {name: imported(name) - {"hallsym"} for name in MODULES if name != "hallsym"}
    done: set[str] = set()

    def walk(name: str, path: list[str]) -> None:
        assert name not in path, " -> ".join([*path[path.index(name) :], name])
        if name not in done:
            for other in graph[name]:
                walk(other, [*path, name])
            done.add(name)

    for name in graph:
        walk(name, [])


def test_every_package_is_one_that_the_layout_names() -> None:
    folders = {p.parent.name for p in ROOT.glob("hallsym/*/__init__.py")}
    assert folders <= set(PACKAGES), folders - set(PACKAGES)


def test_shared_code_names_no_family() -> None:
    shared = [name for name in SHARED if package(name) != "families" and name.startswith("hallsym")]
    assert {name: read(name)[1] for name in shared if read(name)[1]} == {}


def test_only_public_names_are_there_to_tab_through() -> None:
    script = "import hallsym, hallsym.cli.main; print(*[n for n in dir(hallsym) if not n.startswith('__')])"
    shown = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    import hallsym

    assert shown == [name for name in hallsym.__all__ if not name.startswith("__")]
    assert all(hasattr(hallsym, name) for name in hallsym.__all__)


def test_help_and_import_load_no_heavy_library() -> None:
    script = (
        "import sys, hallsym\nfrom hallsym.cli.main import main\nmain([])\n"
        "print(*sorted({'casadi', 'numpy', 'scipy', 'matplotlib', 'pyarrow'} & set(sys.modules)))"
    )
    out = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert out.splitlines()[-1] == ""


GOES_THROUGH = 40
"""Modules that a default fit of a dict of arrays goes through: so many a reader who follows it can hold."""


def test_a_fit_goes_through_few_modules() -> None:
    script = """
import sys
from hallsym import bundled_campaign, fit
log = bundled_campaign()
columns, seen = {c: log.array(c) for c in log.columns}, set()

def called(frame, event, arg):
    if event == "call" and frame.f_code.co_flags & 2:  # of a function, not of a module or a class
        seen.add(frame.f_code.co_filename)

sys.setprofile(called)
fit(columns, "stage31")
sys.setprofile(None)
print(*seen, sep="\\n")
"""
    run = [sys.executable, "-c", script]
    files = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    own = {str(path) for path in MODULES.values()}
    assert len(own.intersection(files)) <= GOES_THROUGH, sorted(own.intersection(files))
