"""A word that does not exist is answered with the nearest one that does."""

from pathlib import Path

import pytest

from hallsym.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "near", "way_out"),
    [
        (["dignose", "log.csv"], "did you mean 'diagnose'?", "see hallsym --help"),
        (["fit", "log.csv", "--modle", "stage31"], "did you mean '--model'?", "see hallsym fit --help"),
        (["fit", "--holdot=3"], "did you mean '--holdout'?", "see hallsym fit --help"),
        (["--verison"], "did you mean '--version'?", "see hallsym --help"),
        (["sensitivity", "--profiles", "al"], "did you mean 'all'?", "see hallsym sensitivity --help"),
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
