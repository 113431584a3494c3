"""The parameter table: its layout, CRC-32, binary and JSON forms."""

import hashlib
import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hallsym.codegen.expressions import Decoupler
from hallsym.codegen.printer import Real

VERSION = 1
"""Of the generated interface and of the head of the table."""


@dataclass(frozen=True, eq=False)
class Table:
    """The numbers of one calibration in the layout of one decoupler.

    Head: version, layout, CRC-32 (uint32 each, little-endian; one more word of zeros before doubles), then the
    entries. The CRC covers coefficients and limits, not the zeros, which a reset changes.
    """

    decoupler: Decoupler
    real: Real
    source: Mapping[str, Any]
    """What it came from: model, sha256 of the calibration, sha256 of the log."""

    @property
    def layout(self) -> int:
        """CRC-32 over names, units and arithmetic: code and table belong together if it is the same."""
        return layout_of(self.decoupler, self.real)

    @property
    def covered(self) -> bytes:
        """The bytes that the CRC covers."""
        d = self.decoupler
        return self._packed([e.value for e in (*d.table, *d.limits)])

    @property
    def crc(self) -> int:
        """CRC-32 (IEEE 802.3, as zlib has it)."""
        return zlib.crc32(self.covered)

    @property
    def binary(self) -> bytes:
        """The table as it lies in the flash of a little-endian controller."""
        head = struct.pack("<III", VERSION, self.layout, self.crc)
        pad = b"\0" * (4 if self.real.size == 8 else 0)
        return head + pad + self.covered + self._packed([e.value for e in self.decoupler.zeros])

    def _packed(self, values: list[float]) -> bytes:
        return struct.pack(f"<{len(values)}{'f' if self.real.size == 4 else 'd'}", *values)

    def json(self) -> str:
        """Return the readable record."""
        d = self.decoupler
        record = {
            "format": "hallsym decoupler parameters 1",
            **self.source,
            "version": VERSION,
            "layout": f"0x{self.layout:08x}",
            "crc32": f"0x{self.crc:08x}",
            "type": self.real.name,
            "parameters": [
                {"name": e.name, "value": float(self.real.dtype(e.value)), "unit": e.unit, "meaning": e.meaning}
                for e in d.entries
            ],
        }
        return json.dumps(record, indent=1) + "\n"


def layout_of(decoupler: Decoupler, real: Real) -> int:
    """Return the CRC-32 of what code and table must agree on."""
    lines = [f"{VERSION} {real.name}"]
    lines += [f"{e.name} {e.unit}" for e in decoupler.entries]
    lines += [f"{s.name} = {s.expression}" for s in decoupler.steps]
    return zlib.crc32("\n".join(lines).encode())


def sha256(data: bytes) -> str:
    """Return the SHA-256 of a file's bytes in hex."""
    return hashlib.sha256(data).hexdigest()
