"""Each mistake of the table is named in every log it is made in; the same logs without it pass silently."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from mistakes import ENCODER, FIT, LOG, STAGE, Mistake, base, made, rails

from hallsym import build
from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.estimation import fit
from hallsym.families import published
from hallsym.log import Fault, Log, check_log, clean_log, write_log

EVERY = sorted((*LOG, *FIT), key=lambda m: m.on == STAGE)
"""A fit that searches for a mistake takes seconds: every fourth of these is made in the log of 57 runs, the
others in that of 6."""
QUICK = ("20 % on", "degrees for rad", "counts of another", "an inverted")
"""Of the fits of encoders, one of each kind; of the stage, one of which the command is asked."""
SLOW = [m for m in FIT if m.on == STAGE or not m.name.removeprefix("encoder: ").startswith(QUICK)]
CASES = [
    pytest.param(m, n, id=f"{m.name}, {n}", marks=pytest.mark.slow if n != m.on[-1] or m in SLOW else ())
    for m in EVERY
    for n in ([m.on[0 if FIT.index(m) % 4 == 0 else -1]] if m in FIT else m.on)
]
ONE_OF_EACH = {(m.ends, m.found): (m, m.on[-1]) for m in EVERY}.values()
LONGEST = 300
MODELS = {**dict.fromkeys(STAGE, "stage31"), **dict.fromkeys(ENCODER, "rotary")}


def columns_of(log: Log) -> list[str]:
    """Return the columns that a fit of the log uses."""
    return [name for name in log.columns if name not in ("run", "t_s")]


def sentences(mistake: Mistake, log: Log) -> tuple[str, list[str]]:
    """How it ends, and everything that is said."""
    try:
        if mistake.found == "log":
            said = check_log(log, columns_of(log))
            return "claim" if any(isinstance(note, Fault) for note in said) else "remark", said
        found = fit(log, solver="direct")
    except InputError as error:
        return "refusal", [str(error)]
    return "claim" if found.claims else "remark", [*found.notes, *(claim.text for claim in found.claims)]


@pytest.mark.parametrize(("mistake", "name"), CASES)
def test_each_mistake_is_named(mistake: Mistake, name: str) -> None:
    ends, said = sentences(mistake, made(mistake, name))
    assert any(re.search(mistake.says, text) for text in said), said
    assert ends == mistake.ends or (mistake.ends == "claim" and ends == "refusal" and mistake.found == "fit")
    assert all(len(text) <= LONGEST and "\n" not in text for text in said), said


@pytest.mark.parametrize("name", STAGE)
def test_rails_of_a_few_samples_behind_noise_are_noticed(name: str) -> None:
    """Not named: what is left of 4 % without them is not yet nine tenths less."""
    arrays, noise = base(name)
    few = rails(("hall_a_m",), 0.04, noise=5e-7)({c: x.copy() for c, x in arrays.items()})
    assert fit(Log.from_arrays(few, noise), solver="direct", accept=["all"]).goodness.sentence


@pytest.mark.parametrize("name", [*STAGE, *ENCODER])
def test_nothing_is_said_of_the_logs_without_a_mistake(name: str) -> None:
    log = Log.from_arrays(*base(name))
    assert check_log(log) == []
    found = fit(log, MODELS[name], solver="direct")
    assert (found.claims, [note for note in found.notes if name in STAGE]) == ((), [])


@pytest.mark.parametrize(("mistake", "name"), ONE_OF_EACH)
def test_the_command_names_a_mistake_and_ends_with_its_code(
    mistake: Mistake,
    name: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """2 for a refusal; 3 for a claim, with the sentence on stderr too; 0 for a remark."""
    log = made(mistake, name)
    held = log.table.pieces(log.columns, log.rows)
    write_log(next(iter(held)), tmp_path / "log.parquet")
    noise = {column: sigma.value for column, sigma in log.noise.sigmas.items()}
    (tmp_path / "meta.json").write_text(json.dumps({"base_model": MODELS[name], "noise_1sigma": noise}))
    monkeypatch.chdir(tmp_path)  # a long path would be part of each sentence
    code = main(["fit", "."])
    out, err = capsys.readouterr()
    assert code in {"refusal": (2,), "remark": (0,), "claim": (2, 3)}[mistake.ends], err
    assert re.search(mistake.says, out if mistake.ends == "remark" else err), err
    assert all(len(line) <= LONGEST + len("hallsym: ") for line in err.splitlines()), err
    assert (out == "") == (code == 2)


HEALED = [m for m in EVERY if "frozen" in m.name or "drops out" in m.name]


@pytest.mark.parametrize("mistake", [m for m in HEALED if STAGE[0] in m.on], ids=lambda m: m.name)
def test_gains_are_right_without_the_bad_samples(mistake: Mistake) -> None:
    """Within five standard uncertainties; with them eta is up to hundreds off."""
    model, truth = build("stage31"), published.values("table7_estimates")
    log = made(mistake, STAGE[0])
    found = fit(clean_log(log, columns_of(log)), model, solver="direct", drop_bad=True)
    for parameter in ("eta_A", "eta_B", "eta_C"):
        k = model.names.index(parameter)
        if np.isfinite(found.std[k]):
            assert abs(found.values[k] - truth[parameter]) < 5 * found.std[k], parameter
