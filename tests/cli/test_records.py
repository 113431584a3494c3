"""What `--json` of every command prints is valid by the schema of its record, which names all of its keys."""

import json
from contextlib import contextmanager
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import hallsym
from hallsym.cli import COMMANDS, capture, records
from hallsym.cli.main import main

DATA = Path(__file__).resolve().parents[2] / "data"
RING = f"{DATA}/ring --model rings3"
SLOW = pytest.mark.slow
LINES = [
    "budget calib.json LOG --at angle_deg=10 --monte-carlo 10000 --plots budget,uncertainty_map",
    f"budget {DATA}/micromachines2019/table2_budget.toml --curve c.json --monte-carlo 10000",
    "capture board --columns counter,v_sin_v --lines 2 -o captured.csv",
    "codegen calib.json -o firmware",
    pytest.param("demo -o demo", marks=SLOW),
    pytest.param("diagnose LOG --model rotary", marks=SLOW),
    "evaluate calib.json LOG twice.csv",
    "evaluate calib.json LOG --plots errors_by_setting",
    "export calib.json --table csv --entries 64 -o table.csv",
    "fit LOG --model rotary --solver direct",
    f"fit {RING} --reference constant-speed",
    pytest.param("fleet LOG --model rotary --workers 1", marks=SLOW),
    "info",
    "info corrections",
    "info calib.json",
    "info LOG",
    "info LOG --write columns.toml",
    f"info {DATA}/encoder/campaign.toml",
    "info rotary",
    "info hysteresis",
    "info clock_jitter",
    "info c.json",
    "plan --like-paper --runs 4",
    f"plan --reference constant-speed --model rings3 --after {DATA}/ring --accuracy 0.01deg",
    "report calib.json LOG -o page.html",
    "sensitivity calib.json LOG --plots correlation",
    f"simulate {DATA}/encoder/campaign.toml -o made.csv --seed 1",
    "sort bench.csv --field 0mT,475mT --model rotary --sets 3",
    "tolerances --model rotary --samples 64",
    "tolerances --model halbach --along x_m --effect gain_mismatch --set gain_0_percent=1",
    "trajectory circle.csv --method cubic -o circle.json",
    "trajectory c.json",
]


class Board:
    """A port with two lines to read."""

    in_waiting, sent = 0, (b"\n", b"0,1\n1,2\n")

    def read(self, size: int) -> bytes:
        piece, self.sent = self.sent[0], self.sent[1:]
        return piece


@contextmanager
def board(port: str, baud: int):
    yield Board()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A calibration, a curve, points, readings of sensors, and a log without a sample to decode."""
    path = tmp_path_factory.mktemp("records")
    hallsym.fit(DATA / "encoder", "rotary", solver="direct").save(path / "calib.json")
    t = np.linspace(0, 1, 30)
    np.savetxt(
        path / "circle.csv", np.c_[np.cos(t), np.sin(t)], delimiter=",", header="x_mm,y_mm", comments=""
    )
    assert (
        main(["trajectory", str(path / "circle.csv"), "--method", "cubic", "-o", str(path / "c.json")]) == 0
    )
    rng = np.random.default_rng(0)
    rows = [
        f"s{k % 12},{1 + 0.01 * rng.standard_normal()},{2 + 0.02 * rng.standard_normal()}" for k in range(16)
    ]
    (path / "bench.csv").write_text("\n".join(["sensor,reading_0_v,reading_1_v", *rows]) + "\n")
    (path / "twice.csv").write_text("t_s,v_sin_v\n0,1\n")
    return path


@pytest.mark.parametrize("line", LINES)
def test_what_json_prints_is_valid(line, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(capture, "open_port", board)
    command, *words = ({"LOG": f"{DATA}/encoder"}.get(word, word) for word in line.split())
    assert main([command, *words, "--json"]) in (0, 2, 3)
    if "--plots" in words:  # a folder, called as its pictures are
        folder = Path(words[-1])
        assert sorted(path.stem for path in folder.iterdir()) == folder.name.split(",")
        assert all(path.read_bytes().startswith(b"\x89PNG") for path in folder.iterdir())
    found = json.loads(capsys.readouterr().out)
    assert next(iter(found)) == "format"
    schema = records.schema(command)
    jsonschema.Draft202012Validator.check_schema(schema)
    check = jsonschema.Draft202012Validator(schema)
    assert [error.message for error in check.iter_errors(found)] == []
    kinds = [schema["$defs"][each["$ref"].rpartition("/")[2]]["properties"] for each in schema["anyOf"]]
    assert any(set(found) <= {"format", *keys} for keys in kinds), "a key that no record names"
    if command == "info":
        assert main([command, *words]) == 0
        assert len(capsys.readouterr().out.splitlines()) > 1


def test_every_command_has_a_schema_and_a_line():
    tried = {(line if isinstance(line, str) else line.values[0]).split()[0] for line in LINES}
    assert tried == set(records.COMMANDS) == set(COMMANDS)
