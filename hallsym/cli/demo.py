"""`hallsym demo`: the paper's calibration on the bundled campaign."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from hallsym.cli import OK, paper
from hallsym.cli.common import command, progress_of, save_fit_pictures, say
from hallsym.report.text.fit import fit_text


def add(sub: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        sub, "demo", run,
        "Calibrate the bundled 6-DOF stage campaign as Chen et al. (Sensors 2016, 16, 872) do: designed\n"
        "parameters, Model (30), Model (31), each beside the paper's own error table.",
    )  # fmt: skip
    parser.add_argument(
        "-o",
        "--output",
        default="demo",
        metavar="FOLDER",
        help="where calib.json and pictures go (default: demo)",
    )


def run(options: Namespace) -> int:
    """Carry the command out."""
    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)
    log, result, steps = paper.reproduce(on_progress=progress_of(options))
    result.save(folder / "calib.json")
    pictures = save_fit_pictures(log, result, str(folder))
    record = {"steps": steps, "calibration": result.to_dict(), "pictures": [str(p) for p in pictures]}
    wrote = [folder / "calib.json", *pictures]
    say(options, record, lambda: paper.text(steps) + "\n\n" + fit_text(result), wrote=wrote)
    return OK
