"""JSON Schemas: what is written is valid by them, and what they refuse is refused where it is read."""

import copy
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import hallsym

ROOT = Path(__file__).resolve().parents[1]
SCHEMAS = {
    "calibration": hallsym.calibration_schema,
    "diagnosis": hallsym.diagnosis_schema,
    "meta": hallsym.meta_schema,
}


@cache
def records(kind: str) -> list[Any]:
    stage, encoder = hallsym.bundled_campaign(), hallsym.read_log(ROOT / "data/encoder")
    if kind == "meta":
        return [dict(log.meta.raw) for log in (stage, encoder)] + [{}, {"own": [1, {"b": None}]}]
    if kind == "calibration":
        made = [
            hallsym.fit(log, name, solver="direct") for log, name in ((stage, "stage31"), (encoder, "rotary"))
        ]
    else:
        made = [hallsym.diagnose(encoder, name) for name in ("rotary_meng", "rotary")]
    return [json.loads(json.dumps(result.to_dict(), allow_nan=False)) for result in made]


def validator(kind: str) -> jsonschema.Draft202012Validator:
    schema = SCHEMAS[kind]()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def read(kind: str, data: Any, folder: Path) -> None:
    """Read a record as the commands do."""
    if kind == "calibration":
        (folder / "calib.json").write_text(json.dumps(data))
        hallsym.load_fit(folder / "calib.json")
    elif kind == "diagnosis":
        assert hallsym.Diagnosis.from_dict(data).to_dict() == data
    else:
        hallsym.Meta.from_dict(data)


@pytest.mark.parametrize("kind", SCHEMAS)
def test_what_is_written_is_valid_and_read_again(kind, tmp_path):
    check = validator(kind)
    for record in records(kind):
        assert [error.message for error in check.iter_errors(record)] == []
        read(kind, record, tmp_path)


def refusal(kind: str, data: Any, folder: Path) -> str:
    """What is said of a record, nothing of one that is taken."""
    try:
        read(kind, data, folder)
    except hallsym.InputError as error:
        return str(error)
    return ""


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place of a record; of a list its first entry."""
    if path:
        yield path
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places(value, (*path, key))
    elif isinstance(data, list) and data:
        yield from places(data[0], (*path, 0))


def changed(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    """A copy with another value at a place, or without the place."""
    made = copy.deepcopy(data)
    at = made
    for key in path[:-1]:
        at = at[key]
    if value is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return made


@pytest.mark.slow
@pytest.mark.parametrize("kind", SCHEMAS)
def test_what_a_schema_refuses_is_refused_in_one_sentence(kind, tmp_path):
    check, record = validator(kind), records(kind)[0]
    tried = refused = 0
    for path in list(places(record))[:: 23 if kind == "calibration" else 3]:
        for value in (..., "no", -1.5, {}, None):
            data = changed(record, path, value)
            tried += 1
            if check.is_valid(data):
                continue
            refused += 1
            said = refusal(kind, data, tmp_path)
            assert said, f"{value!r} at {path} was taken"
            assert len(said) <= 300
    assert refused > 0.3 * tried


def test_a_wrong_key_of_a_diagnosis_is_named():
    record = records("diagnosis")[0]
    with pytest.raises(
        hallsym.InputError, match=r"Key 'metric.before' of the diagnosis must be a number.*'x'"
    ):
        hallsym.Diagnosis.from_dict(changed(record, ("metric", "before"), "x"))
    with pytest.raises(
        hallsym.InputError, match="The diagnosis is incomplete: 'ranked' is missing; diagnose"
    ):
        hallsym.Diagnosis.from_dict(changed(record, ("ranked",), ...))
