"""`hallsym trajectory`: what it prints, what it writes, and one sentence for what it refuses."""

import json

import pytest
from cycloid import TEXT

from hallsym.cli.main import main
from hallsym.trajectory import read_curve

CYCLOID = ["--curve", TEXT, "--range", "t=0:2*pi", "--value", "r=1mm"]


def run(capsys, *words, code=0) -> str:
    assert main(["trajectory", *map(str, words)]) == code
    said = capsys.readouterr()
    if code:
        assert said.err.count("\n") == 1
        assert said.err.startswith("hallsym: ")
    return said.err if code else said.out


def test_stated_points_and_method(capsys):
    words = (*CYCLOID, "--points", 12, "--method", "bernstein", "--json")
    record = json.loads(run(capsys, *words))
    assert record["max_error_m"] == pytest.approx(9.67e-9, rel=5e-3)
    assert (record["control_points"], record["method"]) == (12, "bernstein")


def test_control_points_alone_fit_201_points(capsys):
    record = json.loads(run(capsys, *CYCLOID, "--control", 11, "--json"))
    assert (record["method"], record["points"], record["control_points"]) == ("bernstein-ls", 201, 11)
    assert record["max_error_m"] == pytest.approx(0.0131e-6, rel=0.01)


def test_nothing_is_written_if_one_output_cannot_be(capsys, tmp_path):
    words = ("--points", 9, "--method", "cubic", "-o", tmp_path / "a.json", "-o", tmp_path / "a.ngc")
    assert "blocks; at most" in run(capsys, *CYCLOID, *words, "--chord", "1e-12um", code=2)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_everything_is_written(capsys, tmp_path):
    files = [tmp_path / name for name in ("c.json", "c.ngc", "c.csv")]
    outputs = [word for file in files for word in ("-o", file)]
    text = run(
        capsys, *CYCLOID, "--tolerance", "0.05um", *outputs, "--chord", "0.1um", "--duration", "1s", "--step",
        "100ms",
    )  # fmt: skip
    assert "fewest numbers to store" in text
    assert all(file.stat().st_size > 200 for file in files)
    assert read_curve(files[0]).max_error_m <= 0.05e-6
    record = json.loads(run(capsys, files[0], "--json", "-o", tmp_path / "again.json"))
    assert record["control_points"] == 10
    assert main(["info", str(files[0])]) == 0
    assert "bernstein-chebyshev, 10 control points, error 0.04178 um (bounded)" in capsys.readouterr().out
    assert record["length_m"] == pytest.approx(8e-3, rel=1e-3)


def test_points(capsys, tmp_path):
    rows = "".join(f"{k},{k * k}\n" for k in range(9))
    (tmp_path / "p.csv").write_text("x_um,y_um\n" + rows, encoding="utf-8")
    text = run(capsys, tmp_path / "p.csv", "--method", "cubic")
    assert "(at the points)" in text
    (tmp_path / "t.csv").write_text("t,x_um,y_um\n" + "".join(f"{k},{k},{k * k}\n" for k in range(9)))
    words = (tmp_path / "t.csv", "--method", "bernstein-ls")
    assert "3 control points" in run(capsys, *words, "--tolerance", "1nm")  # a parabola
    assert "not within the tolerance" in run(capsys, *words, "--tolerance", "1e-9pm", code=2)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "either a file of POINTS or the nominal --curve"),
        (["p.csv", *CYCLOID], "either a file of POINTS"),
        (["p.csv", "--points", "4"], "--points belongs to --curve"),
        (["--curve", "x = t"], "--range"),
        ([*CYCLOID], "Give a --tolerance"),
        ([*CYCLOID, "--tolerance", "0.05"], "with its unit"),
        ([*CYCLOID, "--tolerance", "0.05um", "--points", "5"], "No curve holds 0.05 um"),
        ([*CYCLOID, "--points", "10", "--control", "12"], "10 points for 12 control points"),
        ([*CYCLOID, "--points", "0"], "takes 2 to 100 points; 0 asked for"),
        ([*CYCLOID, "--points", "9", "--control", "0"], "takes 2 to 40 control points; 0 asked for"),
        ([*CYCLOID, "--points", "9", "--method", "cubik"], "did you mean 'cubic'"),
        ([*CYCLOID, "--points", "9", "--method", "cubic", "--control", "4"], "belongs to least squares"),
        ([*CYCLOID, "--points", "9", "-o", "a.txt"], "must end with one of"),
        ([*CYCLOID, "--points", "9", "-o", "a.csv"], "needs --duration and --step"),
        ([*CYCLOID, "--points", "9", "--step", "1s"], "needs --duration and --step"),
        ([*CYCLOID, "--points", "9", "--duration", "1s"], "belongs to a .csv or to G-code"),
        ([*CYCLOID, "--points", "9", "--chord", "1um"], "G-code needs both --chord and -o"),
        ([*CYCLOID, "--points", "9", "--value", "r=2mm"], "gives a name twice"),
        (["none.json"], "does not exist"),
        (["none.json", "--tolerance", "1um"], "is made already"),
    ],
)
def test_refused(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert said in run(capsys, *words, code=2)
    assert not list(tmp_path.iterdir())
