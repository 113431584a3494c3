"""A machine file: the probes of a stage and changed parameters, as TOML."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hallsym.log import Meta
from hallsym.toml import Table


@dataclass(frozen=True, eq=False)
class Machine:
    """`probes` as in a log's meta.json, None for the log's own; `parameters` as `build` takes."""

    probes: list[dict[str, Any]] | None
    parameters: dict[str, dict[str, Any]]

    def applied(self, meta: Meta) -> Meta:
        """Return `meta` with this machine's probes in place of the log's own."""
        return meta if self.probes is None else replace(meta, probes=self.probes)


def read_machine(path: str | Path | None) -> Machine:
    """Read `[[probes]]` and `[parameters.NAME]`; no file is a machine without changes.

    Raises `InputError` for a missing or invalid file and for keys that would be ignored.
    """
    if path is None:
        return Machine(None, {})
    file = Table.read(path, "Machine file", ("probes", "parameters"))
    probes = [dict(probe.raw) for probe in file.tables("probes")] if "probes" in file else None
    named = file.table("parameters")
    return Machine(probes, {name: dict(named.table(name).raw) for name in named.raw})
