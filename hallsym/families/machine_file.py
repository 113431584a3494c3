"""A machine file: the layout of a machine and changed parameters, as TOML."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hallsym.families import FAMILIES
from hallsym.log import Meta
from hallsym.toml import Table


@dataclass(frozen=True, eq=False)
class Machine:
    """`probes` as in a log's meta.json, None for the log's own; `parameters` as `build` takes.

    `tables`: those that a family reads besides (`Family.tables`).
    """

    probes: list[dict[str, Any]] | None
    parameters: dict[str, dict[str, Any]]
    tables: Mapping[str, Any] = field(default_factory=dict)

    def applied(self, meta: Meta) -> Meta:
        """Return `meta` with this machine's probes and tables in place of the log's own."""
        probes = meta.probes if self.probes is None else self.probes
        return replace(meta, probes=probes, raw={**meta.raw, **self.tables})


def read_machine(path: str | Path | None) -> Machine:
    """Read `[[probes]]`, `[parameters.NAME]` and tables of a family; no file is a machine without changes.

    Raises `InputError` for a missing or invalid file and for keys that would be ignored.
    """
    if path is None:
        return Machine(None, {})
    own = [name for family in FAMILIES for name in family.tables]
    file = Table.read(path, "Machine file", ("probes", "parameters", *own))
    probes = [dict(probe.raw) for probe in file.tables("probes")] if "probes" in file else None
    named = file.table("parameters")
    parameters = {name: dict(named.table(name).raw) for name in named.raw}
    return Machine(probes, parameters, {name: file.raw[name] for name in own if name in file})
