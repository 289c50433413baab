"""Read the text and the cells of .csv files as spreadsheets and pandas write them in any country."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator

_MARKS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_INDEX = ("", "Unnamed: 0", "index")
"""How pandas names the column of its index."""


def decoded(raw: bytes) -> str:
    """The text of a file in UTF-8 or UTF-16, or in Windows' western encoding; a ValueError where it is none."""
    for mark, encoding in _MARKS:
        if raw.startswith(mark):
            return raw.decode(encoding)
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        if b"\0" in raw:
            raise
        return raw.decode("cp1252")


def cells(text: str) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """The names in the first line, and the number and the cells of each other line that is not empty.

    Cells are divided by commas, semicolons or tabs. A comma within a cell's number is a decimal point. A column of
    pandas' index is left out. Raises csv.Error.
    """
    first, _, rest = text.partition("\n")
    given = re.fullmatch(r'"?sep=(.)"?', first.strip())
    if given:
        text, first = rest, rest.partition("\n")[0]
    divider = given[1] if given else max(",;\t", key=first.count)
    lines = csv.reader(io.StringIO(text, newline=""), delimiter=divider, strict=True)
    header = [cell.strip() for cell in next(lines, [])]
    start = 1 if len(header) > 1 and header[0] in _INDEX else 0

    def rows() -> Iterator[tuple[int, list[str]]]:
        for line in lines:
            if any(cell.strip() for cell in line):
                yield lines.line_num, [_plain(cell.strip()) for cell in line[start:]]

    return header[start:], rows()


def _plain(cell: str) -> str:
    return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell
