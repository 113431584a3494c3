"""What a log says of itself beside its samples (`meta.json`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

import msgspec

from hallsym.errors import InputError, quoted
from hallsym.reading import read_json
from hallsym.records import schema_of, structured

Positive = Annotated[float, msgspec.Meta(gt=0, le=1e100)]
Run = Annotated[int, msgspec.Meta(ge=-(2**53), le=2**53)]


class MetaRecord(msgspec.Struct):
    """Facts about a campaign; everything is optional, null is absent."""

    device: str | None = None
    base_model: str | None = None
    nominal: dict[str, Any] = {}
    probes: list[dict[str, Any]] | None = None
    validation_runs: list[Run] = []
    gap_length_scale_m: Positive | None = None
    gap_threshold_rel: Positive | None = None
    noise_1sigma: dict[str, Positive] = {}
    counts_per_turn: Annotated[float, msgspec.Meta(ge=2, le=1e100)] | None = None


@dataclass(frozen=True, eq=False)
class Meta:
    """Facts about a campaign; everything is optional and `raw` keeps the file's own words.

    `device` says which machine was recorded.
    `holdout` holds run ids to judge on, `nominal` design values by parameter name, `probes` one entry per
    channel with `channel`, `position_m` and `senses`; `gap_length_scale_m` turns rotation into length and
    `gap_threshold_rel` is the relative improvement that is worth reporting.
    """

    device: str | None = None
    base_model: str | None = None
    nominal: dict[str, Any] = field(default_factory=dict)
    probes: list[dict[str, Any]] | None = None
    holdout: tuple[int, ...] = ()
    gap_length_scale_m: float | None = None
    gap_threshold_rel: float | None = None
    noise_1sigma: dict[str, float] = field(default_factory=dict)
    raw: dict[str, Any] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    """SI columns of the log it belongs to, which say in what form the sensor was read."""

    @staticmethod
    def from_dict(raw: Mapping[str, Any], where: str = "meta") -> Meta:
        """Build from the keys of a `meta.json`; unknown keys stay in `raw`, unless they are misspelt ones.

        Raises `InputError` that names the key.
        """
        known = set(MetaRecord.__struct_fields__)
        for key in raw:
            near = get_close_matches(key, known, n=1, cutoff=_MISSPELT)
            if key not in known and near:
                raise InputError(f"Unknown key {key!r} in {where} (did you mean {near[0]!r}?); correct it.")
        entries = {name: value for name, value in raw.items() if name in known and value is not None}
        record = structured(entries, MetaRecord, where, "correct that place")
        found = {name: getattr(record, name) for name in known - {"counts_per_turn", "validation_runs"}}
        return Meta(raw=dict(raw), holdout=tuple(record.validation_runs), **found)

    @staticmethod
    def read(path: Path) -> Meta:
        """Read a `meta.json`."""
        raw = read_json(path, "File", "correct that place")
        if not isinstance(raw, dict):
            raise InputError(f"{quoted(path)} must hold a JSON object; it holds a {type(raw).__name__}.")
        return Meta.from_dict(raw, quoted(path))


def meta_schema() -> dict[str, Any]:
    """Return the JSON Schema of `meta.json`, from the types that are checked when a log is read."""
    return schema_of(MetaRecord, "hallsym log metadata")


_MISSPELT = 0.85
"""Likeness (`difflib`) of a key with a known one from which on it is that one misspelt: a letter or two."""
