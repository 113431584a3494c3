"""A fleet: one row a device, and what the devices have in common."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from hallsym.errors import InputError, quoted
from hallsym.files import atomic_write, replacing
from hallsym.fleets.row import GOOD, STD, VALUE, VERDICTS
from hallsym.fleets.sources import ORDER_COLUMN
from hallsym.fleets.spread import CHANCE, MAD, Spread, spread_of
from hallsym.model import Model
from hallsym.shown import Shown

FORMAT = "hallsym fleet 1"
FIXED = ("device", "log", ORDER_COLUMN, "verdict", "reason")
COLUMNS = (
    "model", "effects", "rows", "runs", "residual_over_noise", "cost_per_degree_of_freedom", "worst_run",
    "worst_channel", "diagnosis", "causes", "diagnosis_reason", "seconds",
)  # fmt: skip
"""Columns of the table beside parameters and covariates, in this order."""
KNOWN = (*FIXED, *COLUMNS)
ENOUGH, DEGREES = 8, 5
"""Devices from which on residuals are compared, and degrees of freedom of Student's t that stands for their
distribution: residuals of good devices scatter more than normal ones."""


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(Shown):
    """What `fleet` returns. `rows`: one a device, in production order; `save` writes them as a table.

    `model`: of the devices that were fitted, None where none was. `seconds`: of the whole fleet.
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
        """Names of the devices, in production order."""
        return tuple(str(row["device"]) for row in self.rows)

    def column(self, name: str) -> np.ndarray:
        """Return a column of numbers, (devices,); nan where a device has none."""
        return np.array([_number(row.get(name)) for row in self.rows])

    @cached_property
    def verdicts(self) -> dict[str, tuple[str, ...]]:
        """Devices by verdict, in the order of `VERDICTS`; verdicts of no device are left out."""
        found = {v: tuple(str(r["device"]) for r in self.rows if r["verdict"] == v) for v in VERDICTS}
        return {verdict: devices for verdict, devices in found.items() if devices}

    @cached_property
    def spreads(self) -> tuple[Spread, ...]:
        """How each parameter differs between the devices whose model describes them."""
        good = np.array([row["verdict"] == GOOD for row in self.rows], dtype=bool)
        along = {ORDER_COLUMN: self.column(ORDER_COLUMN)[good]}
        along |= {c: self.column(c)[good] for c in self.covariates}
        devices = [d for d, use in zip(self.devices, good, strict=True) if use]
        found = [
            spread_of(
                name, self._unit(name), self.column(VALUE + name)[good], self.column(STD + name)[good],
                devices, columns=along, tests=len(self.parameters),
                period=self.model.period.get(name) if self.model else None,
            )
            for name in self.parameters
        ]  # fmt: skip
        return tuple(spread for spread in found if spread is not None)

    def _unit(self, name: str) -> str:
        known = {p.name: p.unit for p in self.model.parameters} if self.model else {}
        return known.get(name, "")

    @cached_property
    def outlying(self) -> dict[str, str]:
        """Devices that differ from the others, and in what: a sentence each, the worst verdict first."""
        out: dict[str, str] = {}
        for verdict in VERDICTS:
            for row in self.rows:
                if row["verdict"] == verdict != GOOD:
                    out[str(row["device"])] = f"{verdict}: {row.get('reason') or VERDICTS[verdict]}"
        for spread in self.spreads:
            for device, score in sorted(spread.outlying.items(), key=lambda item: -abs(item[1])):
                side = "above" if score > 0 else "below"
                far = f"{spread.name} is {abs(score):.1f} standard deviations {side} the others"
                out[device] = f"{out[device]}; {far}" if device in out else far
        for device, ratio in self._loud.items():
            said = f"leaves {ratio:.2f} x the noise, more than the others"
            out[device] = f"{out[device]}; {said}" if device in out else said
        return out

    @cached_property
    def _loud(self) -> dict[str, float]:
        """Good devices whose residual over noise is not that of the others."""
        good = [r for r in self.rows if r["verdict"] == GOOD]
        ratio = np.array([_number(r.get("residual_over_noise")) for r in good])
        if len(ratio) < ENOUGH:
            return {}
        logs = np.log(np.maximum(ratio, 1e-12))
        middle = np.median(logs)
        spread = max(MAD * float(np.median(np.abs(logs - middle))), 1e-3)
        far = float(stdtrit(DEGREES, 1 - CHANCE / len(logs)))
        score = (logs - middle) / spread
        return {
            str(row["device"]): float(value)
            for row, value, z in zip(good, ratio, score, strict=True)
            if z > far
        }

    @cached_property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Devices of the same diagnosis, else of the same verdict: groups of two or more, largest first."""
        keys: dict[str, list[str]] = {}
        for row in self.rows:
            if row.get("diagnosis"):
                key = f"{row['diagnosis']}: {row['causes']}" if row.get("causes") else str(row["diagnosis"])
            else:
                key = str(row["verdict"])
            keys.setdefault(key, []).append(str(row["device"]))
        counted = Counter({key: len(devices) for key, devices in keys.items()})
        return {key: tuple(keys[key]) for key, count in counted.most_common() if count > 1}

    def to_dict(self) -> dict[str, Any]:
        """Return the record that `hallsym fleet --json` prints."""
        return {
            "format": FORMAT,
            "model": self.model.name if self.model else None,
            "devices": len(self.rows),
            "seconds": self.seconds,
            "verdicts": {verdict: len(devices) for verdict, devices in self.verdicts.items()},
            "spread": {
                s.name: {
                    "unit": s.unit, "devices": s.devices, "mean": s.mean, "mean_std": s.mean_std,
                    "std": s.std, "interval": list(s.interval), "scatter": s.scatter,
                    "typical_std": s.typical_std,
                    "trends": {t.column: vars(t) for t in s.trends},
                }
                for s in self.spreads
            },
            "outlying": self.outlying,
            "groups": {key: list(devices) for key, devices in self.groups.items()},
            "rows": [dict(row) for row in self.rows],
        }  # fmt: skip

    def save(self, path: str | Path) -> None:
        """Write the table: Parquet, CSV, or JSON with all that was found, by the suffix."""
        suffix = Path(path).suffix.lower()
        if suffix == ".json":
            atomic_write(path, json.dumps(self.to_dict(), indent=1) + "\n")
            return
        if suffix not in (".parquet", ".pq", ".csv"):
            raise InputError(f"A fleet is saved as .parquet, .csv or .json; instead received {quoted(path)}.")
        import pyarrow as arrow
        from pyarrow import csv, parquet

        table = arrow.table(self.table())
        about = {"hallsym": json.dumps({"format": FORMAT, "seconds": self.seconds})}
        with replacing(path) as temporary:
            if suffix == ".csv":
                csv.write_csv(table, temporary)
            else:
                parquet.write_table(table.replace_schema_metadata(about), temporary)

    def table(self) -> dict[str, list[Any]]:
        """Return the table by columns: device first, each parameter as its value and 1 sigma, in SI."""
        shown = [*FIXED, *self.covariates, *(c for c in COLUMNS if c in self._keys)]
        shown += [prefix + name for name in self.parameters for prefix in (VALUE, STD)]
        return {key: [row.get(key) for row in self.rows] for key in shown}


def load_fleet(path: str | Path, model: Model | None = None) -> Fleet:
    """Read a table that `Fleet.save` wrote as Parquet or CSV; `model`: of the devices, for their units."""
    from pyarrow import ArrowException, csv, parquet

    if not Path(path).is_file():
        raise InputError(f"There is no fleet {quoted(path)}; make one with 'hallsym fleet LOGS -o {path}'.")
    try:
        table = csv.read_csv(path) if Path(path).suffix.lower() == ".csv" else parquet.read_table(path)
    except ArrowException as error:
        raise InputError(f"File {quoted(path)} must be a table of a fleet; it cannot be read.") from error
    if not set(FIXED) <= set(table.column_names):
        raise InputError(f"File {quoted(path)} must be a table of a fleet; it has no column 'verdict'.")
    rows = table.to_pylist()
    return Fleet(tuple({k: v for k, v in row.items() if v is not None} | {"reason": row["reason"] or ""}
                       for row in rows), model or _model(rows))  # fmt: skip


def _model(rows: Sequence[Mapping[str, Any]]) -> Model | None:
    from hallsym.families import build

    for row in rows:
        if row.get("model"):
            return build(row["model"])
    return None


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else float("nan")
