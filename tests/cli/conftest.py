"""A command as a person runs it: exit code, standard output, standard error; and how one is refused."""

import numpy as np
import pytest
from twins import record, with_noise

from hallsym.cli.main import main
from hallsym.errors import LONGEST
from hallsym.estimation import fit


@pytest.fixture
def run(capsys):
    """Return what runs a command: `run("fit", log) -> (code, out, err)`."""

    def run(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        try:
            code = main([str(word) for word in words])
        except SystemExit as end:
            code = end.code
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def refused(run):
    """Return what runs a command that must be refused, and returns the one sentence of it."""

    def refused(*words: object) -> str:
        code, out, err = run(*words)
        assert (code, out) == (2, ""), err
        assert err.startswith("hallsym")
        assert err.count("\n") == 1
        assert len(err) <= LONGEST + len("hallsym: \n")
        assert err.rstrip("\n").isprintable()
        return err

    return refused


@pytest.fixture(scope="session")
def stage(tmp_path_factory):
    """A folder with calib.json and its log.csv, of Model (31), and curve.json, a cycloid of 0.05 mm."""
    where = tmp_path_factory.mktemp("stage")
    columns = record(seed=1)
    fit(with_noise(columns), "stage31", solver="direct", loss="none").save(where / "calib.json")
    with open(where / "log.csv", "w") as file:
        file.write(",".join(columns) + "\n")
        np.savetxt(file, np.column_stack(list(columns.values())), delimiter=",", fmt="%.12g")
    cycloid = [
        "--curve",
        "x = r*(t - sin(t)); y = r*(1 - cos(t))",
        "--range",
        "t=0:2*pi",
        "--value",
        "r=50um",
    ]
    how = ["--points", "8", "--method", "bernstein", "-o", str(where / "curve.json")]
    assert main(["trajectory", *cycloid, *how]) == 0
    return where
