"""Readers of TOML tables: a value that cannot be is one sentence that names the key and the place."""

import pytest

from hallsym.errors import InputError
from hallsym.toml import Table, unit_of

RAW = {
    "n": 3, "half": 0.5, "name": " stage ", "on": True, "list": [1, 2.5], "span": [-1, 2], "inverted": [2, 1],
    "box": {"x_um": 300, "rz_urad": 2}, "run": [{"a": 1}, {"b": 2}], "kind": "sinus",
}  # fmt: skip


def test_what_is_there_is_read_and_what_is_not_has_its_default():
    table = Table(RAW, "file a.toml")
    assert (table.number("half"), table.positive("missing", 2.0), table.whole("n")) == (0.5, 2.0, 3)
    assert table.text("name") == "stage"
    assert table.numbers("list") == [1.0, 2.5]
    assert table.pair("span") == (-1.0, 2.0)
    assert [entry.where for entry in table.tables("run")] == ["a [[run]] of file a.toml"] * 2
    assert table.tables("missing") == []
    found = [(c, factor) for _, c, factor in table.table("box").columns(("x_m", "rz_rad"))]
    assert found == [("x_m", 1e-6), ("rz_rad", 1e-6)]


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (lambda t: t.number("name"), "'name' of file a.toml must be a finite number"),
        (lambda t: t.number("on"), "'on' of file a.toml must be a finite number; instead received True"),
        (lambda t: t.number("half", least=1.0), "must be a number >= 1"),
        (lambda t: t.positive("missing"), "must be a positive number; instead received None"),
        (lambda t: t.whole("half"), "must be a whole number, 1 or more"),
        (lambda t: t.whole("n", least=4), "must be a whole number, 4 or more"),
        (lambda t: t.numbers("half"), "must be a list of numbers"),
        (lambda t: t.pair("list"), None),
        (lambda t: t.pair("inverted"), "must be .lowest, highest"),
        (lambda t: t.text("n"), "must be text"),
        (lambda t: t.choice("kind", ("sine", "ramp")), "did you mean 'sine'"),
        (lambda t: t.table("n"), r"n must be a table \[n\]"),
        (lambda t: t.tables("box"), r"box must be \[\[box\]\] tables"),
        (lambda t: t.table("box", ("x_mm",)), "Unknown key 'x_um' in .*did you mean 'x_mm'"),
        (lambda t: list(t.table("box").columns(("x_m",))), "Unknown key 'rz_urad'"),
        (lambda t: list(t.table("box").columns(("x_rad", "rz_rad"))), "must end with a unit of 'x'"),
        (lambda t: list(Table({"x_m": 1, "x_um": 1}, "b").columns(("x_m",))), "given twice"),
        (lambda t: unit_of("nmm", "file a.toml"), "Unit 'nmm' of file a.toml is not known"),
    ],
)
def test_what_cannot_be_is_one_sentence(read, words):
    table = Table(RAW, "file a.toml")
    if words is None:
        assert read(table) == (1.0, 2.5)
        return
    with pytest.raises(InputError, match=words) as caught:
        read(table)
    assert str(caught.value).endswith(".")
