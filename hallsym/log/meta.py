"""Facts that a log states beside its samples (`meta.json`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np

from hallsym.errors import InputError, nearest, quoted
from hallsym.files import read_json
from hallsym.records import schema_of, structured
from hallsym.units import UNITS, quantity, split_unit

SAMPLES = 20_000
"""Of a log, evenly over all of it, from which a family reads what a file does not state of its machine."""
_MISSPELT = 0.85
"""Similarity (`difflib`) of a key to a known one above which it is that one misspelt: a letter or two."""
Positive = Annotated[float, msgspec.Meta(gt=0, le=1e100)]
Run = Annotated[int, msgspec.Meta(ge=-(2**53), le=2**53)]


class MetaRecord(msgspec.Struct):
    """Facts about a campaign; everything is optional, null is absent."""

    device: str | None = None
    base_model: str | None = None
    nominal: dict[str, Any] | None = {}
    probes: list[dict[str, Any]] | None = None
    validation_runs: list[Run] | None = []
    gap_length_scale_m: Positive | None = None
    gap_threshold_rel: Positive | None = None
    noise_1sigma: dict[str, Positive] | None = {}
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
    column: Callable[[str], np.ndarray] | None = field(default=None, repr=False)
    """Reads a column of that log, for a machine of which a file does not state all."""

    def sample(self, columns: Sequence[str], count: int = SAMPLES) -> np.ndarray:
        """Return columns of the log (columns, samples) at `count` of its rows, (0, 0) where there is none."""
        if self.column is None or not set(columns) <= set(self.columns):
            return np.zeros((0, 0))
        rows = np.array([self.column(c) for c in columns])
        rows = rows[:, np.isfinite(rows).all(axis=0)]
        return rows[:, np.unique(np.linspace(0, rows.shape[1] - 1, count).astype(int))]

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
        return Meta(raw=dict(raw), holdout=tuple(record.validation_runs or ()), **found)

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


@dataclass(frozen=True)
class Sigma:
    """One standard deviation in the channel's SI unit, stated or estimated.

    `within`: factor within which an estimate is known. Differences of neighbouring samples give half of a
    noise that is correlated over two samples (measured: .27 for .515 um).
    """

    value: Annotated[float, msgspec.Meta(ge=0)]
    source: Literal["given", "estimated"]
    within: float = 2.0

    @property
    def uncertain(self) -> float:
        """Factor within which it is known."""
        return self.within if self.source == "estimated" else 1.0


class Noise(dict[str, Sigma]):
    """Noise by SI channel: `noise["hall_a_m"].value`. One that is absent is unknown, an `InputError`."""

    @staticmethod
    def given(values: Mapping[str, float], columns: Sequence[str]) -> Noise:
        """Spread stated values over columns: `hall_m` means every `hall_*_m`, `col_v` every `col_*_v`.

        A key in another unit (`hall_um`) is converted; the exact column wins over its group.
        """
        sigmas: dict[str, Sigma] = {}
        for column in columns:
            keys = [key for key in values if _fits(key, column)]
            if keys:
                key = max(keys, key=len)
                sigmas[column] = Sigma(values[key] * _factor(key), "given")
        return Noise(sigmas)

    @property
    def sigmas(self) -> dict[str, Sigma]:
        """The same, by channel."""
        return self

    @property
    def std(self) -> dict[str, float]:
        """Standard deviation by channel, in SI."""
        return {channel: sigma.value for channel, sigma in self.items()}

    def merged(self, other: Noise) -> Noise:
        """Return this noise with further channels of `other`; existing ones stay."""
        return Noise({**other, **self})

    def __missing__(self, channel: str) -> Sigma:
        """Refuse a channel whose noise is unknown."""
        raise InputError(
            f"Noise of channel '{channel}' is not known{nearest(channel, list(self))};"
            " give it in the column file's [noise] table or in meta.json, or estimate it."
        )


def check_noise_keys(
    values: Mapping[str, float], columns: Sequence[str], where: str, *, strict: bool = True
) -> list[str]:
    """Return stated noise that belongs to no column; refuse it, or, unless `strict`, one that is misspelt."""
    groups = [c for c in ("hall_m", "hall_v", "col_v") if any(_fits(c, column) for column in columns)]
    unused = [key for key in values if not any(_fits(key, column) for column in columns)]
    for key in unused:
        stem, unit = split_unit(key)
        near = get_close_matches(key, [*groups, *columns], n=1, cutoff=_MISSPELT)
        if strict or (near and not (unit and quantity(stem))):
            raise InputError(
                f"Noise '{key}' of {where} belongs to no column of the log"
                f"{nearest(key, [*groups, *columns])}; the columns are {', '.join(columns)}."
            )
    return unused


def _fits(key: str, column: str) -> bool:
    if key == column:
        return True
    key_stem, _, key_unit = key.rpartition("_")
    stem, unit = split_unit(column)
    if unit is None or key_unit not in UNITS or UNITS[key_unit].si != unit.si:
        return False
    rest = stem.removeprefix(f"{key_stem}_")
    return stem == key_stem or (rest != stem and rest != "ref" and "_" not in rest)


def _factor(key: str) -> float:
    unit = UNITS.get(key.rpartition("_")[2])
    return unit.factor if unit else 1.0
