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


def test_stated_points_and_basis(capsys):
    words = (*CYCLOID, "--points", 12, "--basis", "bernstein", "--json")
    record = json.loads(run(capsys, *words))
    assert record["max_error_m"] == pytest.approx(9.67e-9, rel=5e-3)
    assert (record["control_points"], record["method"]) == (12, "bernstein")
    record = json.loads(run(capsys, *words, "--nodes", "chebyshev"))
    assert record["max_error_m"] == pytest.approx(8.0e-10, rel=0.01)


def test_table_4_and_what_its_ends_hide(capsys):
    words = ("--points", 51, "--nodes", "interior", "--control", 10, "--basis", "bernstein", "--json")
    record = json.loads(run(capsys, *CYCLOID, *words))
    assert record["max_error_m"] == pytest.approx(0.2602e-6, rel=2e-3)
    assert record["max_error_between_points_m"] == pytest.approx(0.0384e-6, rel=3e-3)
    assert "where it grows to 0.260" in " ".join(record["notes"])


def test_control_points_alone_fit_201_points(capsys):
    record = json.loads(run(capsys, *CYCLOID, "--control", 11, "--json"))
    assert (record["method"], record["points"], record["control_points"]) == ("bernstein-ls", 201, 11)
    assert record["max_error_m"] == pytest.approx(0.0131e-6, rel=0.01)


def test_nothing_is_written_if_one_output_cannot_be(capsys, tmp_path):
    words = ("--points", 9, "--basis", "trigonometric", "-o", tmp_path / "a.json", "-o", tmp_path / "a.c")
    assert "not made of polynomials" in run(capsys, *CYCLOID, *words, code=2)
    assert not list(tmp_path.iterdir())


def test_everything_is_written(capsys, tmp_path):
    files = [tmp_path / name for name in ("c.json", "c.ngc", "c.c", "c.csv")]
    outputs = [word for file in files for word in ("-o", file)]
    text = run(
        capsys, *CYCLOID, "--tolerance", "0.05um", *outputs, "--chord", "0.1um", "--duration", "1s", "--step",
        "100ms", "--plots", tmp_path / "pictures",
    )  # fmt: skip
    assert "fewest numbers to store" in text
    assert text.count("wrote ") == 14  # five files, three pictures as png, pdf and svg
    assert all(file.stat().st_size > 200 for file in [*files, tmp_path / "c.h"])
    assert len(list((tmp_path / "pictures").glob("trajectory_*.png"))) == 3
    assert read_curve(files[0]).max_error_m <= 0.05e-6
    record = json.loads(run(capsys, files[0], "--json", "-o", tmp_path / "again.c"))
    assert record["control_points"] == 10
    assert main(["info", str(files[0])]) == 0
    assert "bernstein, 10 control points, error 0.04178 um (bounded)" in capsys.readouterr().out
    assert record["length_m"] == pytest.approx(8e-3, rel=1e-3)


def test_points(capsys, tmp_path):
    rows = "".join(f"{k},{k * k}\n" for k in range(9))
    (tmp_path / "p.csv").write_text("x_um,y_um\n" + rows, encoding="utf-8")
    text = run(capsys, tmp_path / "p.csv", "--method", "cubic", "--plots", tmp_path)
    assert "estimated by leaving points out" in text
    assert (tmp_path / "trajectory_curve.png").exists()
    assert "below the rounding" in run(capsys, tmp_path / "p.csv", "--tolerance", "0.01um", code=2)
    assert "No curve holds" in run(
        capsys, tmp_path / "p.csv", "--tolerance", "1pm", "--rounding", "1pm", code=2
    )


def test_five_points_of_which_a_method_makes_nothing(capsys, tmp_path):
    (tmp_path / "p.csv").write_text("x_um,y_um\n0,0\n100,100\n0,200\n-100,100\n0,0\n", encoding="utf-8")
    assert "AAA finds no rational function" in run(capsys, tmp_path / "p.csv")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "either a file of POINTS or the nominal --curve"),
        (["p.csv", *CYCLOID], "either a file of POINTS"),
        (["p.csv", "--points", "4"], "--points belongs to --curve"),
        (["--curve", "x = t"], "--range"),
        ([*CYCLOID], "Give a --tolerance"),
        ([*CYCLOID, "--tolerance", "0.05"], "with its unit"),
        ([*CYCLOID, "--tolerance", "1s"], "with its unit"),
        ([*CYCLOID, "--tolerance", "1e-12um"], "below what float64 can hold"),
        ([*CYCLOID, "--tolerance", "0.05um", "--points", "5"], "No curve holds 0.05 um"),
        ([*CYCLOID, "--points", "10", "--control", "12"], "10 points for 12 control points"),
        ([*CYCLOID, "--points", "1"], "at least 2 points"),
        ([*CYCLOID, "--points", "0"], "at least 2 points; 0 asked for"),
        ([*CYCLOID, "--points", "9", "--control", "0"], "at least 1 control points; 0 asked for"),
        (["p.csv", "--points", "0"], "--points belongs to --curve"),
        ([*CYCLOID, "--points", "9", "--feed", "0", "-o", "a.ngc"], "positive speed"),
        ([*CYCLOID, "--points", "9", "--basis", "fourier"], "Basis 'fourier' is not known"),
        ([*CYCLOID, "--points", "9", "--method", "cubik"], "did you mean 'cubic'"),
        ([*CYCLOID, "--points", "9", "--nodes", "cheb"], "did you mean 'chebyshev'"),
        ([*CYCLOID, "--points", "9", "--basis", "bernstein", "--method", "cubic"], "not both"),
        ([*CYCLOID, "--points", "9", "--method", "cubic", "--control", "4"], "belongs to least squares"),
        ([*CYCLOID, "--points", "9", "--rounding", "1nm"], "--rounding belongs to a file"),
        ([*CYCLOID, "--points", "9", "-o", "a.txt"], "must end with one of"),
        ([*CYCLOID, "--points", "9", "-o", "a.csv"], "needs --duration and --step"),
        ([*CYCLOID, "--points", "9", "--step", "1s"], "belong to a .csv"),
        ([*CYCLOID, "--points", "9", "--chord", "1um"], "belongs to a G-code output"),
        ([*CYCLOID, "--points", "9", "--value", "r=2mm"], "gives a name twice"),
        ([*CYCLOID, "--points", "9", "--method", "trigonometric", "-o", "a.c"], "not made of polynomials"),
        (["none.json"], "does not exist"),
        (["none.csv"], "does not exist"),
        (["none.json", "--tolerance", "1um"], "is made already"),
    ],
)
def test_refused(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert said in run(capsys, *words, code=2)
    assert not list(tmp_path.iterdir())
