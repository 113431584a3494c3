"""The package: what it says of itself, and that it installs into a new environment and runs there."""

import os
import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest

import hallsym

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_version_is_one():
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    assert cited
    assert cited[1] == PROJECT["version"] == hallsym.__version__


def test_all_is_every_extra_that_a_user_may_want():
    extras = PROJECT["optional-dependencies"]
    named = re.search(r"\[(.*)\]", extras["all"][0])
    assert named
    # `mdf` is asked for by name
    assert set(named[1].split(",")) == set(extras) - {"all", "mdf", "test", "lint", "docs", "bench"}


def test_types_are_published():
    assert (ROOT / "hallsym" / "py.typed").exists()
    assert (ROOT / "solvers" / "py.typed").exists()
    assert "Typing :: Typed" in PROJECT["classifiers"]
    assert all(url.startswith("https://") for url in PROJECT["urls"].values())


def test_the_hooks_are_what_make_lint_runs():
    hooks = re.findall(
        r"entry: \.venv/bin/(.*)", (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    )
    lint = re.search(r"^lint:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    assert lint
    assert hooks == [line.strip().removeprefix("$(BIN)/") for line in lint[1].splitlines()]


def test_the_workflow_calls_make():
    workflow = (ROOT / ".github" / "workflows" / "test.yml").read_text(encoding="utf-8")
    assert re.search(r"- run: make test\b", workflow)


def run(*words: str | Path, cwd: Path) -> str:
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(words, cwd=cwd, env=own, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """Source archive and wheel, the wheel made from the archive."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT, cwd=folder)
    return folder


@pytest.mark.slow
def test_what_is_built_passes_the_check_of_the_index(built):
    files = sorted(path.name for path in built.iterdir())
    assert [re.sub(r"hallsym-[\d.]+\d", "", name) for name in files] == ["-py3-none-any.whl", ".tar.gz"]
    said = run(sys.executable, "-m", "twine", "check", "--strict", *sorted(built.iterdir()), cwd=built)
    assert said.count("PASSED") == 2


@pytest.mark.slow
def test_it_installs_and_runs_in_a_new_environment(built, tmp_path):
    """With what it depends on, and outside of the checkout."""
    venv.create(tmp_path / "new", with_pip=False)
    python = tmp_path / "new" / "bin" / "python"
    (wheel,) = built.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--python", str(python), "--disable-pip-version-check", "install"]
    run(*pip, "--quiet", wheel, cwd=tmp_path)
    hallsym_command = tmp_path / "new" / "bin" / "hallsym"
    assert "Model (31), fitted runs" in run(hallsym_command, "demo", cwd=tmp_path)
    script = "import hallsym; print(hallsym.__file__, hallsym.bundled_campaign().rows, hallsym.__version__)"
    where, rows, version = run(python, "-I", "-c", script, cwd=tmp_path).split()
    assert str(tmp_path) in where
    assert Path(where).with_name("py.typed").exists()
    assert (int(rows), version) == (5700, PROJECT["version"])
