"""What leaves hallsym: no control character, no password, no number that JSON does not have."""

import csv
import io
import os
import resource
import subprocess
import sys
import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hallsym
from hallsym.cli.main import LEAST_MEMORY, main
from hallsym.errors import InputError
from hallsym.files import json_text, write_json
from hallsym.output import commented, csv_text, fitted, printable, toml_text
from hallsym.report.content import _environment
from hallsym.report.tables import grid

BAD = "a\x1b[31m\nb\r\x9b2J\u202ec\x7f\u2028*/d"
"""What ends a line or a comment, and what a terminal takes as a command: ESC, C1, bidi, DEL."""
SECRET = "https://me:secret@host/log.csv"


@given(st.text())
def test_text_is_printable_in_every_form(text):
    assert all(c.isprintable() or c.isspace() for c in printable(text))
    assert "\n" not in commented(text)
    assert "*/" not in commented(f"*{text}/")
    assert list(csv.reader(io.StringIO(csv_text([[text, "x"], ["y", 1]]))))[1] == ["y", "1"]
    assert len(grid([[text, "x"], ["y", "1"]]).split("\n")) >= 3


@given(st.text(st.characters(codec="utf-8")))
def test_a_string_of_toml_reads_back(text):
    line = f"name = {toml_text(text)}"
    assert line.isprintable()
    assert tomllib.loads(line) == {"name": text}


def test_a_password_is_nowhere():
    for shown in (printable(SECRET), fitted(f"wrote {SECRET}"), str(InputError(SECRET)), commented(SECRET)):
        assert "secret" not in shown
        assert "host" in shown
    assert printable("a@b, C:/x@y/log.csv") == "a@b, C:/x@y/log.csv"


@pytest.mark.parametrize("number", [float("nan"), float("-inf")])
def test_a_number_that_is_not_finite_is_refused_by_name(tmp_path, number):
    with pytest.raises(InputError, match=r"'errors.x_m.1' .* must be finite; it is (nan|-inf)"):
        json_text({"errors": {"x_m": [1.0, number]}})
    path = tmp_path / "result.json"
    with pytest.raises(InputError, match=r"'rmse'"):
        write_json(path, {"rmse": number})
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"'0\.y'"):
        _environment().from_string("{{ data|tojson }}").render(data=[{"y": number}])


def test_names_of_a_file_reach_no_terminal(capsys, tmp_path):
    lines = ["run,t_s,hall_a_m,\x1b[31mx\x9b\u202e_m", *(f"1,{k},{k}e-6,0" for k in range(9)), ""]
    (tmp_path / "log.csv").write_text("\n".join(lines), encoding="utf-8")
    for options in ([], ["--write", "c.toml"], ["--json"]):
        arguments = ["info", "log.csv", *options]
        main([str(tmp_path / a) if "." in a else a for a in arguments])
        said = capsys.readouterr()
        assert all(c.isprintable() or c == "\n" for c in said.out + said.err), arguments
    assert tomllib.loads((tmp_path / "c.toml").read_text(encoding="utf-8"))


def test_a_column_that_would_break_a_file_is_not_written(tmp_path):
    for suffix in (".csv", ".parquet"):
        with pytest.raises(InputError, match="must be named in printable characters"):
            hallsym.write_log({"run": [1, 1], "hall\n_a_m": [1.0, 2.0]}, tmp_path / f"log{suffix}")
    hallsym.write_log({"run": [1, 1], 'hall,"a_m': [1.0, 2.0]}, tmp_path / "log.csv")
    assert hallsym.read_log(tmp_path / "log.csv").array('hall,"a_m').tolist() == [1.0, 2.0]


def command(*words: str, **options):
    """Run a command in a process of its own; returns its exit code and what it said on stderr."""
    call = [sys.executable, "-m", "hallsym", *words]
    done = subprocess.run(call, stderr=subprocess.PIPE, text=True, check=False, **options)
    return done.returncode, done.stderr


@pytest.mark.skipif(os.name != "posix", reason="file descriptors")
def test_a_closed_standard_output_is_one_sentence():
    code, said = command("info", preexec_fn=lambda: os.close(1))
    assert code == 2
    assert said == "hallsym: Cannot write to standard output: it is closed; send it to /dev/null.\n"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory")
@pytest.mark.parametrize("more", [-500 << 20, 80 << 20, 200 << 20])
def test_little_memory_is_one_sentence_and_ends(more):
    """What asks for memory without end uses the processor; on a busy machine all else takes its time."""

    def limited():
        resource.setrlimit(resource.RLIMIT_AS, (LEAST_MEMORY + more, LEAST_MEMORY + more))
        resource.setrlimit(resource.RLIMIT_CPU, (40, 40))

    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    code, said = command("demo", preexec_fn=limited, timeout=600, env=environment, stdout=subprocess.DEVNULL)
    assert code == 2 or (code == 0 and more > 0), said  # that may be enough
    assert ("memory" in said and said.count("\n") == 1) or code == 0
