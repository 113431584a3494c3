"""What is known of the noise of each channel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Annotated, Any, Literal

import msgspec

from hallsym.errors import InputError, nearest
from hallsym.units import UNITS, quantity, split_unit


@dataclass(frozen=True)
class Sigma:
    """One standard deviation in the channel's SI unit, and whether a person gave it or we estimated it.

    `within`: factor within which an estimate is known. Noise that is correlated over two samples is read as
    half of what it is by differences of neighbouring ones (measured: .27 for .515 um).
    """

    value: Annotated[float, msgspec.Meta(ge=0)]
    source: Literal["given", "estimated"]
    within: float = 2.0

    @property
    def uncertain(self) -> float:
        """Factor within which it is known."""
        return self.within if self.source == "estimated" else 1.0


@dataclass(frozen=True, eq=False)
class Noise(Mapping[str, Sigma]):
    """Noise by SI channel: `noise["hall_a_m"].value`. A channel that is absent is unknown."""

    sigmas: dict[str, Sigma] = field(default_factory=dict)

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
    def std(self) -> dict[str, float]:
        """Standard deviation by channel, in SI."""
        return {channel: sigma.value for channel, sigma in self.sigmas.items()}

    def merged(self, other: Noise) -> Noise:
        """Return this noise with what only `other` knows added; what is here already stays."""
        return Noise({**other.sigmas, **self.sigmas})

    def __getitem__(self, channel: str) -> Sigma:
        """Return the noise of a channel; an unknown one is an `InputError`."""
        if channel not in self.sigmas:
            raise InputError(
                f"Noise of channel '{channel}' is not known{nearest(channel, list(self.sigmas))};"
                " give it in the column file's [noise] table or in meta.json, or estimate it."
            )
        return self.sigmas[channel]

    def __contains__(self, channel: object) -> bool:
        """Say whether the noise of a channel is known."""
        return channel in self.sigmas

    def get(self, channel: str, default: Any = None) -> Any:
        """Return the noise of a channel, or `default` where it is unknown."""
        return self.sigmas.get(channel, default)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the channels whose noise is known."""
        return iter(self.sigmas)

    def __len__(self) -> int:
        """Return the number of channels whose noise is known."""
        return len(self.sigmas)


def check_noise_keys(values: Mapping[str, float], columns: Sequence[str], where: str) -> None:
    """Refuse a stated noise that belongs to no column, so that a misspelt key is not ignored."""
    for key in values:
        if not any(_fits(key, column) for column in columns):
            raise InputError(
                f"Noise '{key}' of {where} belongs to no column of the log{nearest(key, list(columns))};"
                f" the columns are {', '.join(columns)}."
            )


_MISSPELT = 0.85
"""Likeness (`difflib`) of a key with a column's name from which on it is that name misspelt."""


def check_misspelt_noise(values: Mapping[str, float], columns: Sequence[str], where: str) -> None:
    """Refuse a stated noise whose key is nearly, but not quite, that of a column.

    Others may stand: a file may state the noise of columns that this log happens not to have, such as
    `temperature_degc`, or in words of its own.
    """
    groups = [c for c in ("hall_m", "hall_v", "col_v") if any(_fits(c, column) for column in columns)]
    for key in values:
        stem, unit = split_unit(key)
        if any(_fits(key, column) for column in columns) or (unit and quantity(stem)):
            continue
        if get_close_matches(key, [*groups, *columns], n=1, cutoff=_MISSPELT):
            check_noise_keys({key: values[key]}, [*groups, *columns], where)


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
