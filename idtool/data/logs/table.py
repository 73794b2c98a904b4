"""Text tables of numbers: a header line, then rows; the delimiter is a comma, semicolon or tab.

The text is parsed by numpy in blocks of bounded size. A block that numpy rejects is parsed again line by line, to tell
what is wrong.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence, Set
from pathlib import Path
from typing import BinaryIO

import numpy as np

from idtool.common.arrays import Array
from idtool.common.exceptions import LogError
from idtool.common.names import printable

_BLOCK_BYTES = 1 << 22
_MAX_LINE = 1 << 20  # bytes
_TRUTH_VALUES = {"true": 1.0, "True": 1.0, "TRUE": 1.0, "false": 0.0, "False": 0.0, "FALSE": 0.0}
_TRUTH_WORDS = tuple(word.encode() for word in _TRUTH_VALUES)
_RECENT_BYTES = 1 << 16  # at the end of a block that the last line is compared with


class CsvTable:
    """A table in an open file.

    Parameters
    ----------
    path
        The file; errors name it.
    file
        The same file, open.

    Attributes
    ----------
    header
        Column names.
    truncated
        After the rows were read: true if the last one was cut off; it is then left out.

    Raises
    ------
    LogError
        If there is no header line.
    """

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._line = 0
        first = b""
        while not first.strip():
            line = file.readline(_MAX_LINE)
            if not line:
                break
            first = line.removeprefix(b"\xef\xbb\xbf")  # byte order mark
            self._line += 1
        try:
            text = first.decode().strip("\r\n")
            splits = {mark: next(csv.reader([text], delimiter=mark, skipinitialspace=True), []) for mark in ",;\t"}
        except (UnicodeDecodeError, csv.Error):
            raise LogError(path, f"line {self._line} cannot be read as column names in UTF-8") from None
        if len(first) == _MAX_LINE:
            raise LogError(path, f"line {self._line} is longer than {_MAX_LINE >> 20} MiB; this is not a CSV log")
        self._delimiter = max(splits, key=lambda mark: len(splits[mark]))
        self.header = [name.strip() for name in splits[self._delimiter]]
        self.truncated = False
        self._flags: Set[int] = frozenset()

    def rows(self, columns: Sequence[int], flags: Set[int] = frozenset()) -> Iterator[Array]:
        """The numbers in ``columns``, block by block, each of shape (k, len(columns)); an empty cell is NaN.

        In the columns ``flags``, true and false are numbers too.

        Raises
        ------
        LogError
            For the first row with another number of cells than the header, or a cell that is not a number.
        """
        self._flags = flags
        rest = b""
        recent = b""
        while block := self._file.read(_BLOCK_BYTES):
            lines, newline, rest = (rest + block).rpartition(b"\n")
            if len(rest) > _MAX_LINE:
                raise LogError(self._path, f"a line is longer than {_MAX_LINE >> 20} MiB; this is not a CSV log")
            yield from self._parse(lines + newline, columns)
            recent = lines[-_RECENT_BYTES:] or recent
        if rest.strip():
            self.truncated = not self._is_complete(rest, recent)
            if not self.truncated:
                yield from self._parse(rest, columns)

    def _is_complete(self, line: bytes, previous_lines: bytes) -> bool:
        """True if a last line without a line end has all cells, and its last cell is as long as those before."""
        delimiter = self._delimiter.encode()
        if line.count(delimiter) < len(self.header) - 1:
            return False
        previous_cells = [row.rpartition(delimiter)[2] for row in previous_lines.split(b"\n")]
        shortest = min(len(cell.strip(b"-\r")) for cell in previous_cells)
        last_cell = line.rpartition(delimiter)[2]
        text = last_cell.decode(errors="replace")
        if self._is_truth_value(text, len(self.header) - 1):
            return True
        return len(last_cell.strip(b"-\r")) >= shortest and _is_number(text)

    def _parse(self, text: bytes, columns: Sequence[int]) -> Iterator[Array]:
        if text.strip():
            if b"\r" in text:
                text = text.replace(b"\r\n", b"\n")
            is_quoted = b'"' in text
            try:
                rows = np.loadtxt(
                    io.BytesIO(self._fill_empty_cells(text)),
                    delimiter=self._delimiter,
                    comments=None,
                    quotechar='"' if is_quoted else None,
                    usecols=columns,
                    converters=self._converters(text),
                    ndmin=2,
                    encoding="latin1",
                )
            except ValueError:
                self._raise_first_fault(text, columns)
                raise LogError(self._path, f"the lines after line {self._line} cannot be read as numbers") from None
            if is_quoted or text.count(self._delimiter.encode()) != len(rows) * (len(self.header) - 1):
                self._raise_first_fault(text, columns)
            yield rows
        self._line += text.count(b"\n")

    def _converters(self, text: bytes) -> dict[int | str, Callable[[str], float]] | None:
        """Functions that read the columns of flags, as `numpy.loadtxt` takes them; None if numpy reads them itself."""
        if self._flags and any(word in text for word in _TRUTH_WORDS):
            return {column: _flag_value for column in self._flags}  # noqa: C420  # whose keys are also text
        return None

    def _is_truth_value(self, cell: str, column: int) -> bool:
        """True if a cell is true or false in a column of flags."""
        return column in self._flags and cell.strip() in _TRUTH_VALUES

    def _fill_empty_cells(self, text: bytes) -> bytes:
        """The text with nan in its empty cells."""
        delimiter = self._delimiter.encode()
        characters = np.frombuffer(text, np.uint8)
        ends = (characters == ord(delimiter)) | (characters == ord("\n"))
        if (ends[1:] & ends[:-1]).any():
            # a,,,b needs two rounds
            for empty in (delimiter + delimiter, delimiter + delimiter, b"\n" + delimiter, delimiter + b"\n"):
                text = text.replace(empty, empty[:1] + b"nan" + empty[1:])
        if text.startswith(delimiter):
            text = b"nan" + text
        if text.endswith(delimiter):
            text += b"nan"
        return text

    def _raise_first_fault(self, text: bytes, columns: Sequence[int]) -> None:
        """Raise LogError for the first line with a fault, if there is one."""
        reader = csv.reader(io.StringIO(text.decode(errors="replace"), newline=""), delimiter=self._delimiter)
        try:
            for row in reader:
                if not row:
                    continue
                line = f"line {self._line + reader.line_num}"
                if len(row) != len(self.header):
                    raise LogError(self._path, f"{line} has {len(row)} cells; the first line has {len(self.header)}")
                for i in columns:
                    if not (_is_number(row[i]) or self._is_truth_value(row[i], i)):
                        message = f"{line}, column {printable(self.header[i])}: '{printable(row[i])}' is not a number"
                        raise LogError(self._path, message)
        except csv.Error as error:
            raise LogError(self._path, f"line {self._line + reader.line_num}: {error}") from None


def _flag_value(cell: str) -> float:
    """Value of a flag; ValueError if it is neither a number nor true or false."""
    truth = _TRUTH_VALUES.get(cell.strip())
    if truth is None and not _is_number(cell):
        raise ValueError(cell)
    return float(cell) if truth is None else truth


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return "_" not in cell  # Python allows underscores between digits
