"""Messages of one line, temporaries, outputs that are inputs, records of JSON."""

import pickle

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym.errors import LONGEST, InputError, one_line, quoted
from hallsym.files import (
    announce,
    atomic_write,
    check_output,
    note_input,
    read_json,
    read_text,
    reading,
    replacing,
    task,
)
from hallsym.records import structured

# -- messages --------------------------------------------------------------------------------------------


@settings(max_examples=50)
@given(st.one_of(st.text(max_size=50), st.text("ab \n\x1b\u202e\ud800", max_size=700)))
def test_a_message_is_one_printable_line(text):
    said = str(InputError(text))
    assert len(said) <= LONGEST
    assert said.isprintable()
    if len(text) <= LONGEST and text.isprintable():
        assert said == text


def test_both_ends_of_a_long_message_stay():
    said = one_line(f"Log {'x' * 500}/log.csv does not exist; give another.")
    assert said.startswith("Log xxx")
    assert said.endswith("/log.csv does not exist; give another.")
    assert "..." in said
    assert str(pickle.loads(pickle.dumps(InputError("a\nb")))) == "a\\nb"


def test_names_with_spaces_are_quoted():
    assert quoted("a/b-1.csv") == "a/b-1.csv"
    assert quoted("my log.csv") == "'my log.csv'"


# -- temporaries -----------------------------------------------------------------------------------------


def test_a_temporary_keeps_the_suffix_and_a_long_name_fits(tmp_path):
    with replacing(tmp_path / "log.parquet") as temporary:
        assert temporary.suffix == ".parquet"
    atomic_write(tmp_path / ("x" * 250 + ".json"), "{}")
    assert (tmp_path / ("x" * 250 + ".json")).read_text() == "{}"


# -- outputs that are inputs -----------------------------------------------------------------------------


def test_what_is_read_in_a_task_is_not_written(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("a")
    (tmp_path / "link.csv").symlink_to(path)
    with task():
        read_text(path, "Log", "is no text", "copy it again")
        for name in (path, tmp_path / "link.csv"):
            with pytest.raises(InputError, match="which would be lost"):
                atomic_write(name, "b")
        with pytest.raises(InputError, match="holds the input"):
            check_output(tmp_path)
        atomic_write(tmp_path / "new.csv", "b")
    assert path.read_text() == "a"
    atomic_write(path, "b")  # a script may
    assert path.read_text() == "b"


def test_what_will_be_written_is_not_read(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("a")
    with task():
        announce(path)
        with pytest.raises(InputError, match="which would be lost"):
            note_input(path)


# -- the boundary ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "error", [ValueError("x\ny"), KeyError("k"), RecursionError(), MemoryError(), OSError("h5")]
)
def test_whatever_a_library_raises_is_one_sentence(error):
    with pytest.raises(InputError, match=r"^Budget file a\.toml .*correct it\.$"), reading(
        "a.toml", "Budget file", "is not valid TOML", "correct it"
    ):  # fmt: skip
        raise error


def test_a_sentence_of_ours_and_ctrl_c_pass_through():
    for error in (InputError("Said."), KeyboardInterrupt("Said.")):
        with pytest.raises(type(error), match="Said"), reading("a", "File", "is damaged"):
            raise error


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "cannot be read as JSON"),
        ('{"a": NaN}', "'a' is nan"),
        ('{"a": 1e999}', "'a' is inf"),
        ('{"a": [1, {"b": 1e60}]}', "'a.1.b' is 1e.60"),
        (f'{{"a": {10**400}}}', "'a' is 1.00e.400"),
        ('{"a": 1, "a": 2}', "key 'a' is given twice"),
        ("[" * 100000, "nested too deeply"),
        ("9" * 5000, "cannot be read as JSON"),
        ("\xff", "cannot be read as JSON"),
    ],
)
def test_json_that_cannot_be(tmp_path, text, words):
    (tmp_path / "a.json").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=words):
        read_json(tmp_path / "a.json", "Record", "make it again")


class Part(msgspec.Struct, forbid_unknown_fields=True):
    value: float
    name: str = ""


class Whole(msgspec.Struct, forbid_unknown_fields=True):
    parts: dict[str, Part]
    runs: list[int] = []


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (
            {"parts": {"a": {"value": 1}, "b": {"value": "x"}}},
            "Key 'parts.b.value' of file f must be a number.*'x'",
        ),
        (
            {"parts": {"a": {"valeu": 1, "value": 2}}},
            "'parts.a' of file f has the unknown key 'valeu' .*'value'",
        ),
        ({"part": {}}, r"File f has the unknown key 'part' \(did you mean 'parts'"),
        ({"parts": {}, "value": 1}, "File f has the unknown key 'value'; correct it"),  # known, but elsewhere
        ({}, "File f is incomplete: 'parts' is missing"),
        ({"parts": {}, "runs": [1, 2.5]}, "Key 'runs.1' of file f must be a whole number.*2.5"),
        ([], "File f must be a table of keys"),
    ],
)  # fmt: skip
def test_a_record_that_cannot_be_names_the_place(raw, words):
    with pytest.raises(InputError, match=words):
        structured(raw, Whole, "file f", "correct it")
