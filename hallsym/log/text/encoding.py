"""Bytes of a text file, compressed or not and in any of the usual codings, as UTF-8 in pieces."""

from __future__ import annotations

import codecs
import gzip
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, cast

from hallsym.errors import InputError

PIECE = 1 << 18
"""Bytes that are read at once."""
END = 1 << 16
"""Bytes of the end of a file in which lines after the table are looked for."""
LONGEST_LINE = 10_000_000
"""Characters of a line: 100,000 columns with long names."""
_GZIP = b"\x1f\x8b"
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
    (codecs.BOM_UTF8, "utf-8-sig"),
)
_WIDE, _NARROW = 0.6, 0.1
"""Share of null bytes at even (odd) places from which on text without a mark is UTF-16; nearly all are."""


@dataclass(frozen=True)
class Encoded:
    """A file of text: its coding, as Python names it, and whether it is compressed.

    `open_raw` opens its bytes; of a file in memory it is not a path that is opened.
    """

    open_raw: Callable[[], IO[bytes]]
    compressed: bool
    encoding: str

    @staticmethod
    def of(source: Path | Callable[[], IO[bytes]]) -> Encoded:
        """Recognise compression and coding by the beginning of the file."""
        open_raw = partial(_open, source) if isinstance(source, Path) else source
        with open_raw() as stream:
            compressed = stream.read(2) == _GZIP
        found = Encoded(open_raw, compressed, "")
        with found.raw() as stream:
            head = stream.read(PIECE)
        return Encoded(open_raw, compressed, _encoding(head))

    @contextmanager
    def raw(self) -> Iterator[IO[bytes]]:
        """Open the bytes, decompressed."""
        with self.open_raw() as stream:
            yield cast(IO[bytes], gzip.GzipFile(fileobj=stream, mode="rb")) if self.compressed else stream

    def pieces(self, size: int = PIECE) -> Iterator[bytes]:
        """Yield the text as UTF-8 without a mark, in pieces of about `size` bytes."""
        with self.raw() as stream:
            if self.encoding.startswith("utf-8"):  # as it is: a bad byte is judged with the cell it stands in
                if self.encoding == "utf-8-sig":
                    stream.read(len(codecs.BOM_UTF8))
                while piece := stream.read(size):
                    yield piece
                return
            decoder = codecs.getincrementaldecoder(self.encoding)("strict")
            while piece := stream.read(size):
                yield decoder.decode(piece).encode("utf-8", "replace")
            decoder.decode(b"", True)

    def lines(self, where: str) -> Iterator[str]:
        """Yield the lines of text, without what ends them; `where` names the file in messages."""
        for line in whole_lines(self.pieces(), where):
            yield from line.decode("utf-8", "replace").split("\n")


def whole_lines(pieces: Iterator[bytes], where: str) -> Iterator[bytes]:
    r"""Yield pieces of whole lines that are separated by \n, and do not end with one, whatever ended them.

    Raises `InputError` for a line that does not end, before it fills the memory.
    """
    rest = b""
    for piece in pieces:
        piece = rest + piece
        end = max(piece.rfind(b"\n"), piece.rfind(b"\r", 0, -1))  # a last \r may belong to a \n
        if end < 0:
            rest = piece
            if len(rest) > LONGEST_LINE:
                raise InputError(
                    f"{where} must be text in lines of at most {LONGEST_LINE} characters; it is no text, so"
                    " the file is damaged or of another format: copy it again, or state its --format."
                )
            continue
        rest = piece[end + 1 :]
        yield unified(piece[:end].removesuffix(b"\r") if piece[end : end + 1] == b"\n" else piece[:end])
    if rest:
        yield unified(rest.removesuffix(b"\n").removesuffix(b"\r"))


def unified(lines: bytes) -> bytes:
    r"""Return lines with \n between them, whatever was."""
    return lines.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in lines else lines


def end_of(file: Encoded, size: int = END) -> str:
    """Return the last bytes of the text, about `size`; of a compressed file all of it is read."""
    if file.compressed or file.encoding not in ("utf-8", "utf-8-sig", "latin-1"):
        last = b""
        for piece in file.pieces():
            last = (last + piece)[-size:]
        return last.decode("utf-8", "replace")
    with file.raw() as stream:
        length = stream.seek(0, os.SEEK_END)
        stream.seek(max(0, length - size))
        return stream.read().decode("latin-1" if file.encoding == "latin-1" else "utf-8", "replace")


def _open(path: Path) -> IO[bytes]:
    return open(path, "rb")


def _encoding(head: bytes) -> str:
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name
    half = max(1, len(head) // 2)
    for first, name in ((1, "utf-16-le"), (0, "utf-16-be")):
        if head[first::2].count(0) > _WIDE * half and head[1 - first :: 2].count(0) < _NARROW * half:
            return name
    try:
        codecs.getincrementaldecoder("utf-8")("strict").decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"
