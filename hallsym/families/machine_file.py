"""A machine file: the probes of a stage and changed parameters, as TOML."""

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, nearest
from hallsym.log import Meta


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
    path = Path(path)
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError:
        raise InputError(f"Machine file {path} cannot be read; give the path of a TOML file.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"Machine file {path} is not valid TOML: {error}.") from None
    for key in raw:
        if key not in ("probes", "parameters"):
            raise InputError(
                f"Unknown key {key!r} in machine file {path}{nearest(key, ['probes', 'parameters'])}; "
                "known are [[probes]] and [parameters.NAME]."
            )
    probes, parameters = raw.get("probes"), raw.get("parameters", {})
    if probes is not None and not (isinstance(probes, list) and all(isinstance(p, dict) for p in probes)):
        raise InputError(f"In machine file {path}, probes must be [[probes]] tables, one for each probe.")
    for name, entry in parameters.items():
        if not isinstance(entry, dict):
            raise InputError(
                f"In machine file {path}, {name} must be a table: [parameters.{name}] nominal = ..."
            )
    return Machine(probes, parameters)
