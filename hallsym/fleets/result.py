"""A fleet: one row a device, what the devices have in common, and what to expect of the next ones."""

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from hallsym.errors import InputError, counted, quoted, require
from hallsym.files import replacing
from hallsym.fleets.row import GOOD, STD, VALUE, VERDICTS
from hallsym.fleets.sources import read_table
from hallsym.fleets.spread import Spread, spread_of
from hallsym.model import Model
from hallsym.output import printable
from hallsym.shown import Shown

FORMAT = "hallsym fleet 1"
FIXED = ("device", "log", "verdict", "reason")
COLUMNS = (
    "model", "effects", "rows", "runs", "residual_over_noise", "cost_per_degree_of_freedom", "worst_run",
    "worst_channel", "diagnosis", "causes", "diagnosis_reason", "seconds",
)  # fmt: skip
"""Columns of the table beside parameters and covariates, in this order."""
KNOWN = (*FIXED, *COLUMNS)
OUTSIDE = 1e-4
"""Share of the next devices whose estimate of a parameter may lie outside its bounds."""


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(Shown):
    """What `fleet` returns. `rows`: one a device, in their order; `save` writes them as a table.

    `model`: of most devices that were fitted, None where none was. `seconds`: of the whole fleet.
    """

    rows: tuple[Mapping[str, Any], ...]
    model: Model | None
    seconds: float = 0.0

    @cached_property
    def _keys(self) -> tuple[str, ...]:
        """Names of all columns; rows of one model have the same."""
        return tuple(dict.fromkeys(key for keys in dict.fromkeys(map(tuple, self.rows)) for key in keys))

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that were fitted."""
        return tuple(key.removeprefix(VALUE) for key in self._keys if key.startswith(VALUE))

    @cached_property
    def covariates(self) -> tuple[str, ...]:
        """Columns of the table of logs that are carried along."""
        return tuple(k for k in self._keys if k not in KNOWN and not k.startswith((VALUE, STD)))

    @property
    def devices(self) -> tuple[str, ...]:
        """Names of the devices."""
        return tuple(str(row["device"]) for row in self.rows)

    def column(self, name: str) -> np.ndarray:
        """Return a column of numbers, (devices,); nan where a device has none."""
        found = [row.get(name) for row in self.rows]
        known = (isinstance(v, int | float) and not isinstance(v, bool) for v in found)
        return np.array([v if number else np.nan for v, number in zip(found, known, strict=True)], float)

    @cached_property
    def verdicts(self) -> dict[str, tuple[str, ...]]:
        """Devices by verdict, in the order of `VERDICTS`; verdicts of no device are left out."""
        found = {v: tuple(str(r["device"]) for r in self.rows if r["verdict"] == v) for v in VERDICTS}
        return {verdict: devices for verdict, devices in found.items() if devices}

    @cached_property
    def spreads(self) -> tuple[Spread, ...]:
        """How each parameter differs between the devices whose model describes them."""
        if self.model is None:
            return ()
        good = self.good
        devices = [d for d, use in zip(self.devices, good, strict=True) if use]
        units = {p.name: p.unit for p in self.model.parameters}
        found = [
            spread_of(
                name, units.get(name, ""), self.column(VALUE + name)[good], self.column(STD + name)[good],
                devices, tests=len(self.parameters), period=self.model.period.get(name),
            )
            for name in self.parameters
        ]  # fmt: skip
        return tuple(spread for spread in found if spread is not None)

    @cached_property
    def good(self) -> np.ndarray:
        """Which devices (devices,) are good, and of the model that most are of."""
        name = self.model.name if self.model else None
        return np.array([r["verdict"] == GOOD and r.get("model") == name for r in self.rows], dtype=bool)

    @cached_property
    def outlying(self) -> dict[str, str]:
        """Devices that differ from the others, and in what: a sentence each, the worst verdict first."""
        out: dict[str, str] = {}
        for verdict in VERDICTS:
            for row, good in zip(self.rows, self.good, strict=True):
                if row["verdict"] == verdict and not good:
                    usual = self.model.name if self.model else None
                    other = row.get("model", usual) != usual
                    known = row.get("diagnosis_reason") if row.get("causes") else row.get("reason")
                    why = f"Its model is {row['model']}, not {usual}." if other else str(known)
                    out[str(row["device"])] = why
        for spread in self.spreads:
            for device, score in sorted(spread.outlying.items(), key=lambda item: -abs(item[1])):
                side = "above" if score > 0 else "below"
                far = f"{spread.name} is {abs(score):.1f} standard deviations {side} the others"
                out[device] = f"{out[device].removesuffix('.')}; {far}" if device in out else far
        return out

    @cached_property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Devices of the same diagnosis and causes: groups of two or more, largest first."""
        keys: dict[str, list[str]] = {}
        for row in self.rows:
            if row.get("diagnosis"):
                key = f"{row['diagnosis']}: {row['causes']}" if row.get("causes") else row["diagnosis"]
                keys.setdefault(key, []).append(str(row["device"]))
        largest = sorted(keys.items(), key=lambda item: -len(item[1]))
        return {key: tuple(devices) for key, devices in largest if len(devices) > 1}

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym fleet --json` prints."""
        return {
            "format": FORMAT,
            "model": self.model.name if self.model else None,
            "devices": len(self.rows),
            "seconds": self.seconds,
            "verdicts": {verdict: len(devices) for verdict, devices in self.verdicts.items()},
            "spread": {
                s.name: {k: v for k, v in asdict(s).items() if k not in ("name", "outlying")}
                for s in self.spreads
            },
            "outlying": self.outlying,
            "groups": {key: list(devices) for key, devices in self.groups.items()},
            "rows": [dict(row) for row in self.rows],
        }  # fmt: skip

    def save(self, path: str | Path) -> None:
        """Write the table: Parquet or CSV, by the suffix."""
        suffix = table_suffix(path)
        import pyarrow as arrow
        from pyarrow import csv, parquet

        table = self.table()
        if suffix == ".csv":
            table = {k: [printable(v) if isinstance(v, str) else v for v in c] for k, c in table.items()}
        with replacing(path) as temporary:
            (csv.write_csv if suffix == ".csv" else parquet.write_table)(arrow.table(table), temporary)

    def table(self) -> dict[str, list[Any]]:
        """Return the table by columns: device first, each parameter as its value and 1 sigma, in SI."""
        shown = [*FIXED, *self.covariates, *(c for c in COLUMNS if c in self._keys)]
        shown += [prefix + name for name in self.parameters for prefix in (VALUE, STD)]
        return {key: [row.get(key) for row in self.rows] for key in shown}


def load_fleet(path: str | Path) -> Fleet:
    """Read a table that `Fleet.save` wrote as Parquet or CSV."""
    if not Path(path).is_file():
        raise InputError(f"There is no fleet {quoted(path)}; make one with 'hallsym fleet LOGS -o {path}'.")
    table = read_table(Path(path))
    if table is None or not set(FIXED) <= set(table.column_names):
        raise InputError(f"File {quoted(path)} must be a table of a fleet; it is none, or damaged.")
    from hallsym.families import build

    rows = [{k: v for k, v in row.items() if v is not None} for row in table.to_pylist()]
    models = Counter(row["model"] for row in rows if "model" in row).most_common(1)
    return Fleet(tuple({"reason": "", **row} for row in rows), build(models[0][0]) if models else None)


def machine_file(fleet: Fleet) -> str:
    """Return the text of a machine file with nominal values and bounds for the next batch.

    Nominal: the mean of the devices. Bounds: a tolerance interval, which holds 9,999 of 10,000 next devices
    or more with a confidence of 95 %. Parameters that repeat are left out: mounting sets them.
    """
    known, devices = _known(fleet)
    lines = [f"# From {devices}; SI units.", ""]
    for s in known:
        low, high = bounds(s)
        lines += [f"[parameters.{s.name}]", f"nominal = {s.mean:.9g}", f"lower = {low:.9g}",
                  f"upper = {high:.9g}", ""]  # fmt: skip
    return "\n".join(lines)


def bounds(spread: Spread) -> tuple[float, float]:
    """Return what the estimates of the next devices lie between but for `OUTSIDE` of them: in 95 % of fleets.

    In 97.5 %, by the upper end of the interval of their spread, less the 1 % in which a good device was taken
    for an outlying one.

    W. G. Howe, J. Am. Stat. Assoc. 64 (1969) 610, doi:10.2307/2283644: the normal quantile times the upper
    confidence limit of the standard deviation, which is also that of the mean about which it is taken.
    """
    sigma = float(np.hypot(spread.interval[1], spread.typical_std)) * (1.0 + 1.0 / spread.devices) ** 0.5
    reach = -float(ndtri(OUTSIDE / 2)) * sigma
    return spread.mean - reach, spread.mean + reach


def tolerance_file(fleet: Fleet) -> str:
    """Return the text of a tolerance file for `hallsym tolerances`: the spread of each parameter, 1 sigma."""
    known, devices = _known(fleet)
    lines = [f"# From {devices}.", 'others = "exact"', "", "[tolerance]"]
    for s in known:
        suffix = re.sub("^1/", "per_", s.unit).lower()
        key = f"{s.name}_{suffix}" if s.unit != "1" else s.name
        lines.append(f"{key} = {{ std = {s.std:.9g} }}" if s.std > 0 else f'{key} = "exact"')
    return "\n".join([*lines, ""])


def _known(fleet: Fleet) -> tuple[list[Spread], str]:
    """Return the spreads that the next batch is made from, and of how many devices they are."""
    period = fleet.model.period if fleet.model else {}
    found = [s for s in fleet.spreads if s.name not in period]
    if not found:
        raise InputError(
            "No parameter has a spread to make bounds or tolerances from: three good devices at least must "
            "determine it."
        )
    return found, counted(max(s.devices for s in fleet.spreads), "device")


def table_suffix(path: str | Path) -> str:
    """Return the suffix of a table of devices; raise `InputError` where no table is written with it."""
    suffix = Path(path).suffix.lower()
    require(suffix in (".parquet", ".csv"), "Output of a fleet", ".parquet or .csv", str(path))
    return suffix
