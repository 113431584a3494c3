"""Picture files are whole or absent, in their own style, and drawn from the log as the fit wires it."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from twins import record, with_noise

from hallsym.errors import InputError
from hallsym.estimation import Fit, fit
from hallsym.log import Log
from hallsym.report import figures as plots

HOLDOUT = (2, 7, 12)
NAMES = ["measured", "errors_before_after", "errors_by_setting", "parameters"]


@pytest.fixture(scope="module")
def log() -> Log:
    return with_noise(record(seed=1))


@pytest.fixture(scope="module")
def fitted(log: Log) -> Fit:
    return fit(log, "stage31", solver="direct", loss="none", holdout=HOLDOUT)


def test_pictures_are_whole_files_in_their_own_style(log: Log, fitted: Fit, tmp_path: Path) -> None:
    import matplotlib

    pyplot = "matplotlib.pyplot" in sys.modules
    with matplotlib.rc_context({"font.size": 17.0, "axes.facecolor": "red"}):
        written = plots.save_pictures(log, fitted, tmp_path / "new" / "folder")
        assert matplotlib.rcParams["font.size"] == 17.0
        assert matplotlib.rcParams["axes.facecolor"] == "red"
    assert ("matplotlib.pyplot" in sys.modules) == pyplot
    assert [path.stem for path in written] == NAMES
    for path in written:
        content = path.read_bytes()
        assert content.startswith(b"\x89PNG\r\n")
        assert content.endswith(b"IEND\xaeB`\x82")
        width = int.from_bytes(content[16:20], "big")
        assert width == round(plots.WIDTH * plots.DPI)
        assert 10_000 < len(content) < 1_000_000
    assert sorted(p.name for p in (tmp_path / "new" / "folder").iterdir()) == sorted(p.name for p in written)


def test_every_kind_of_file_names_its_source(fitted: Fit, tmp_path: Path) -> None:
    draw = {"parameters": lambda: plots.parameters(fitted)}
    places = [plots.Place(tmp_path, kind, "campaign/log.parquet, stage31") for kind in ("png", "pdf", "svg")]
    png, pdf, svg = (plots.save_figures(draw, place)[0] for place in places)
    assert "campaign/log.parquet, stage31" in svg.read_text(encoding="utf-8")
    assert pdf.read_bytes().startswith(b"%PDF")
    (bare,) = plots.save_figures(draw, tmp_path / "bare")
    sizes = [[int.from_bytes(p.read_bytes()[k : k + 4], "big") for k in (16, 20)] for p in (png, bare)]
    assert sizes[0][0] == sizes[1][0] == round(plots.WIDTH * plots.DPI)
    assert sizes[0][1] > sizes[1][1]  # a line of its own, nothing written over
    assert plots.DPI == 300
    first = [path.read_bytes() for path in (png, pdf, svg)]
    assert [plots.save_figures(draw, place)[0].read_bytes() for place in places] == first


def test_a_folder_that_cannot_be_is_one_sentence(log: Log, fitted: Fit, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match=r"^Cannot make the folder .*file.*\.$"):
        plots.save_pictures(log, fitted, tmp_path / "file" / "pictures")
    with pytest.raises(InputError, match=r"^Cannot make the folder .*file.*\.$"):
        plots.save_pictures(log, fitted, tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine"


def test_no_half_written_picture(
    log: Log, fitted: Fit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(figure: object, place: object, path: Path) -> None:
        path.write_bytes(b"\x89PNG half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("hallsym.report.figures.saving." + "_write", full)
    (tmp_path / "measured.png").write_bytes(b"old")
    with pytest.raises(InputError, match=r"Cannot write .*measured\.png: the disk is full"):
        plots.save_pictures(log, fitted, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["measured.png"]
    assert (tmp_path / "measured.png").read_bytes() == b"old"


def test_wiring_of_the_fit_is_applied(
    log: Log, fitted: Fit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b, c = fitted.model.channels
    data = {name: log.array(name) for name in log.columns}
    data |= {a: data[b], b: -data[a]}
    swapped = with_noise(data)
    seen: list[Log] = []

    class EnoughError(Exception):
        pass

    def stop(log: Log, *_: object) -> None:
        seen.append(log)
        raise EnoughError

    monkeypatch.setattr(plots, "look_over", stop)
    wired = replace(fitted, wiring=((b, -1), (a, 1), (c, 1)))
    with pytest.raises(EnoughError):
        plots.save_pictures(swapped, wired, tmp_path)
    np.testing.assert_array_equal(seen[0].array(a), log.array(a))
    np.testing.assert_array_equal(seen[0].array(b), log.array(b))


def test_what_takes_long_to_import_is_imported_only_where_it_is_used() -> None:
    late = ("matplotlib", "scipy.stats", "scipy.optimize", "scipy.interpolate", "pyarrow", "h5py", "SALib")
    script = "import sys, hallsym.cli.main, hallsym.report.figures; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=Path(__file__).parents[2],
        check=True,
        capture_output=True,
        text=True,
    )
    assert "hallsym.report.figures" in done.stdout.split()
    assert not {*late} & {*done.stdout.split()}
