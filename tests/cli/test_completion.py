"""Completion in the shells themselves, and what is said of a misspelt command, option or value."""

import os
import pty
import select
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from hallsym.cli.completion import SHELLS, script
from hallsym.cli.main import main

WORDS = (  # what is typed, what is offered, and what is not
    ("hallsym dia", {"diagnose"}, {"fit"}),
    ("hallsym fit log.csv --hold", {"--holdout"}, {"--model"}),
    ("hallsym fit log.csv --model stage3", {"stage30", "stage31", "stage31_tied"}, {"rotary"}),
    ("hallsym diagnose log.csv --effect hyst", {"hysteresis"}, {"time_skew"}),
    ("hallsym sensitivity --profiles a", {"auto", "all"}, {"none"}),
    ("hallsym info ecc", {"eccentricity"}, {"hysteresis"}),
    ("hallsym fit cam", {"campaign.csv"}, {"other.csv"}),
)


def needs(shell: str) -> str:
    path = shutil.which(shell)
    if path is None:
        pytest.skip(f"{shell} is not installed")
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("campaign.csv", "other.csv"):
        (tmp_path / name).touch()
    for shell in SHELLS:
        (tmp_path / f"complete.{shell}").write_text(script(shell), encoding="utf-8")
    return tmp_path


def test_bash_completes(folder):
    for typed, offered, not_offered in WORDS:
        words = typed.split()
        text = (
            f"source complete.bash; COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; "
            f"$(complete -p hallsym | sed 's/.*-F \\([^ ]*\\).*/\\1/') hallsym; "
            'printf "%s\\n" "${COMPREPLY[@]}"'
        )
        text = text.replace("$(complete -p", "eval $(complete -p")
        found = subprocess.run(
            [needs("bash"), "--norc", "-c", text], cwd=folder, capture_output=True, text=True, check=True
        ).stdout.split()
        assert offered <= set(found), typed
        assert not not_offered & set(found), typed


def test_fish_completes(folder):
    for typed, offered, not_offered in WORDS:
        done = subprocess.run(
            [needs("fish"), "--no-config", "-c", f"source complete.fish; complete -C '{typed}'"],
            cwd=folder, capture_output=True, text=True, check=True,
        )  # fmt: skip
        found = {line.split("\t")[0] for line in done.stdout.splitlines()}
        assert offered <= found, typed
        assert not not_offered & found, typed


def test_zsh_completes(folder):
    """A word that only one thing begins with is completed in a terminal."""
    zsh = needs("zsh")
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        os.execve(zsh, ["zsh", "-f", "-i"], {**os.environ, "TERM": "dumb", "PS1": "> ", "HOME": str(folder)})

    def typed(keys: str, until: str) -> str:
        os.write(terminal, keys.encode())
        seen, end = "", time.monotonic() + 10
        while until not in seen and time.monotonic() < end:
            if select.select([terminal], [], [], 0.2)[0]:
                seen += os.read(terminal, 4096).decode(errors="replace")
        return seen

    try:
        (folder / "_hallsym").write_text(script("zsh"), encoding="utf-8")
        typed("fpath=($PWD $fpath); autoload -U compinit; compinit -u -D; print re''ady\n", "ready\r\n")
        assert "diagnose" in typed("hallsym diag\t", "diagnose")
        assert "--holdout" in typed(" log.csv --hold\t", "--holdout")
        assert "hysteresis" in typed("1 --effect hyst\t", "hysteresis")
        assert "rotary_meng" in typed(" --model rotary_m\t", "rotary_meng")
    finally:
        os.close(terminal)
        os.waitpid(child, 0)


@pytest.mark.parametrize(
    ("arguments", "near", "way_out"),
    [
        (["dignose", "log.csv"], "did you mean 'diagnose'?", "see hallsym --help"),
        (["fit", "log.csv", "--modle", "stage31"], "did you mean '--model'?", "see hallsym fit --help"),
        (["fit", "--holdot=3"], "did you mean '--holdout'?", "see hallsym fit --help"),
        (["--verison"], "did you mean '--version'?", "see hallsym --help"),
        (["sensitivity", "--profiles", "al"], "did you mean 'all'?", "see hallsym sensitivity --help"),
        (["completion", "bsh"], "did you mean 'bash'?", "see hallsym completion --help"),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest_one(capsys, arguments, near, way_out):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    out, err = capsys.readouterr()
    assert (ended.value.code, out, err.count("\n")) == (2, "", 1)
    assert near in err
    assert way_out in err


def test_a_log_in_place_of_a_command_is_told_where_it_belongs(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("lab.csv").write_text("a,b\n1,2\n")
    with pytest.raises(SystemExit):
        main(["lab.csv"])
    assert "did you mean 'hallsym info lab.csv'?" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "word", "near"),
    [
        ("--model", "stage3", "stage31"),
        ("--effect", "histeresis", "hysteresis"),
        ("--solver", "hybrd", "hybrid"),
        ("--loss", "tuky", "tukey"),
        ("--format", "cvs", "csv"),
    ],
)
def test_a_misspelt_value_is_answered_with_the_nearest_one(capsys, option, word, near):
    assert main(["fit", str(Path(__file__).parents[2] / "data" / "campaign"), option, word]) == 2
    assert f"did you mean '{near}'?" in capsys.readouterr().err
