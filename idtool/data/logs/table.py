"""Tables of numbers in text: a first line that names the columns, then rows; comma, semicolon or tab between cells.

The text is read in pieces of bounded size by numpy's parser; what that refuses is looked at line by line, to say what
is wrong.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import LogError
from idtool.common.names import printable

_PIECE_BYTES = 1 << 22
_LONGEST_LINE = 1 << 20  # bytes
_RECENT_BYTES = 1 << 16  # that a last line is compared with


class Table:
    """A table in an open file.

    Parameters
    ----------
    path
        The file; errors name it.
    file
        The same, open.

    Attributes
    ----------
    header
        Names of the columns.
    cut
        Once the rows were read: whether the last one was cut off, and left out.

    Raises
    ------
    LogError
        If there is no first line to name columns.
    """

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._line = 0
        first = b""
        while not first.strip() and (line := file.readline(_LONGEST_LINE)):
            first, self._line = line.removeprefix(b"\xef\xbb\xbf"), self._line + 1
        try:
            text = first.decode().strip("\r\n")
            splits = {mark: next(csv.reader([text], delimiter=mark, skipinitialspace=True), []) for mark in ",;\t"}
        except (UnicodeDecodeError, csv.Error):
            raise LogError(path, f"line {self._line} cannot be read as names of columns in UTF-8") from None
        if len(first) == _LONGEST_LINE:
            raise LogError(path, f"line {self._line} is longer than {_LONGEST_LINE >> 20} MiB; this is no CSV log")
        self._mark = max(splits, key=lambda mark: len(splits[mark]))
        self.header = [name.strip() for name in splits[self._mark]]
        self.cut = False

    def rows(self, columns: Sequence[int]) -> Iterator[Array]:
        """The numbers in ``columns``, piece by piece, each of shape (k, len(columns)); an empty cell is NaN.

        Raises
        ------
        LogError
            For the first row that has another number of cells than the header, or a cell that is no number.
        """
        rest, recent = b"", b""
        while block := self._file.read(_PIECE_BYTES):
            lines, newline, rest = (rest + block).rpartition(b"\n")
            if len(rest) > _LONGEST_LINE:
                raise LogError(self._path, f"a line is longer than {_LONGEST_LINE >> 20} MiB; this is no CSV log")
            yield from self._parsed(lines + newline, columns)
            recent = lines[-_RECENT_BYTES:] or recent
        if rest.strip():
            self.cut = not self._whole(rest, recent)
            if not self.cut:
                yield from self._parsed(rest, columns)

    def _whole(self, line: bytes, before: bytes) -> bool:
        """Whether a last line without a line end has all its cells, and a last one no shorter than those before."""
        mark = self._mark.encode()
        if line.count(mark) < len(self.header) - 1:
            return False
        shortest = min(len(row.rpartition(mark)[2].strip(b"-\r")) for row in before.split(b"\n"))
        last = line.rpartition(mark)[2]
        return len(last.strip(b"-\r")) >= shortest and _is_number(last.decode(errors="replace"))

    def _parsed(self, text: bytes, columns: Sequence[int]) -> Iterator[Array]:
        if text.strip():
            if b"\r" in text:
                text = text.replace(b"\r\n", b"\n")
            quoted = b'"' in text
            rows = None
            try:
                rows = np.loadtxt(
                    io.BytesIO(self._filled(text)),
                    delimiter=self._mark,
                    comments=None,
                    quotechar='"' if quoted else None,
                    usecols=columns,
                    ndmin=2,
                    encoding="latin1",
                )
            except ValueError:
                self._explain(text, columns)
                raise LogError(self._path, f"the lines from {self._line + 1} on cannot be read as numbers") from None
            if quoted or text.count(self._mark.encode()) != len(rows) * (len(self.header) - 1):
                self._explain(text, columns)
            yield rows
        self._line += text.count(b"\n")

    def _filled(self, text: bytes) -> bytes:
        """The text with nan in its empty cells."""
        mark = self._mark.encode()
        characters = np.frombuffer(text, np.uint8)
        ends = (characters == ord(mark)) | (characters == ord("\n"))
        if (ends[1:] & ends[:-1]).any():
            for empty in (mark + mark, mark + mark, b"\n" + mark, mark + b"\n"):  # a,,,b needs two rounds
                text = text.replace(empty, empty[:1] + b"nan" + empty[1:])
        return (b"nan" if text.startswith(mark) else b"") + text + (b"nan" if text.endswith(mark) else b"")

    def _explain(self, text: bytes, columns: Sequence[int]) -> None:
        """Raise LogError for the first line at fault."""
        reader = csv.reader(io.StringIO(text.decode(errors="replace"), newline=""), delimiter=self._mark)
        try:
            for row in filter(None, reader):
                where = f"line {self._line + reader.line_num}"
                if len(row) != len(self.header):
                    raise LogError(self._path, f"{where} has {len(row)} cells; the first line names {len(self.header)}")
                for name, cell in ((self.header[i], row[i]) for i in columns):
                    if not _is_number(cell):
                        raise LogError(
                            self._path, f"{where}, column {printable(name)}: '{printable(cell)}' is no number"
                        )
        except csv.Error as error:
            raise LogError(self._path, f"line {self._line + reader.line_num}: {error}") from None


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return "_" not in cell  # which Python allows between digits
