"""How rows of a query are printed: as a table that fits the terminal, or as JSON."""

from __future__ import annotations

import json
import re
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple, TextIO

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_MAX_CELL = 80
_MIN_WIDTH = 16  # of a column, as of a shortened id
_SHA256 = re.compile("[0-9a-f]{64}")
_NUMBER = re.compile(r"U?(TINY|SMALL|BIG|HUGE)?INT(EGER)?|FLOAT|DOUBLE|DECIMAL.*")

Row = tuple[str | None, ...]


class QueryRows(NamedTuple):
    """The result of a statement: column names, their SQL types, and an iterator of rows of texts."""

    names: list[str]
    types: list[str]
    rows: Iterator[Row]


def write_json(objects: Iterator[str], out: TextIO) -> None:
    """Write an array of objects, one per line; NaN and infinities, which JSON lacks, become null."""
    separator = "[\n"
    for text in objects:
        has_nan = "NaN" in text or "Infinity" in text
        out.write(separator + (nan_to_null(text) if has_nan else text))
        separator = ",\n"
    out.write("[]\n" if separator == "[\n" else "\n]\n")


def nan_to_null(text: str) -> str:
    """Turn DuckDB's JSON into valid JSON."""
    return json.dumps(json.loads(text, parse_constant=lambda _: None), ensure_ascii=False)


def write_table(
    rows: QueryRows,
    out: TextIO,
    *,
    is_shortened: bool = False,
    max_rows: int | None = None,
    width: int | None = None,
) -> None:
    """Write rows in columns, numbers to the right, and how many there are.

    Args:
        rows: the rows.
        out: where to write.
        is_shortened: shorten long cells, visibly, and sha256 ids; not for a file.
        max_rows: the most rows to print; None for all.
        width: of the terminal in characters, None for no limit. Columns are cut to fit it, or each row is
            written as a block of lines.
    """
    shown = [[cell_lines(cell, is_cut=is_shortened) for cell in row] for row in islice(rows.rows, max_rows)]
    is_cut = max_rows is not None and next(rows.rows, None) is not None
    names = [cell_lines(name, is_cut=False) for name in rows.names]
    widths = [
        max(len(line) for cell in column for line in cell) for column in zip(names, *shown, strict=True)
    ]
    fitted = widths if width is None else fit_widths(widths, [len(name[0]) for name in names], width)
    if fitted is None:
        write_blocks(names, shown, width or 0, out)
    else:
        is_number = [_NUMBER.fullmatch(kind) is not None for kind in rows.types]
        for row in (names, [["-" * each] for each in fitted], *shown):
            write_columns(row, fitted, is_number, out)
    noun = "row" if len(shown) == 1 else "rows"
    count = (
        f"the first {max_rows} rows; a file or a pipe gets all of them" if is_cut else f"{len(shown)} {noun}"
    )
    out.write(f"({count})\n")


def write_columns(row: Sequence[list[str]], widths: list[int], is_number: list[bool], out: TextIO) -> None:
    """Write the lines of the cells of one row."""
    for height in range(max(len(cell) for cell in row)):
        lines = (cell[height] if height < len(cell) else "" for cell in row)
        padded = (
            shorten(line, width).rjust(width) if right else shorten(line, width).ljust(width)
            for line, width, right in zip(lines, widths, is_number, strict=True)
        )
        out.write("  ".join(padded).rstrip() + "\n")


def write_blocks(names: list[list[str]], rows: list[list[list[str]]], width: int, out: TextIO) -> None:
    """Write each row as lines of a name and a value, for rows that are too wide for columns."""
    name_width = max(len(name[0]) for name in names)
    for number, row in enumerate(rows, 1):
        out.write(f"-- row {number}\n")
        for name, cell in zip(names, row, strict=True):
            for height, line in enumerate(cell):
                label = name[0] if height == 0 else ""
                out.write(f"{label.ljust(name_width)}  {shorten(line, max(width - name_width - 2, 8))}\n")


def fit_widths(widths: list[int], least: list[int], width: int) -> list[int] | None:
    """Return widths of columns that fit `width`, the widest cut first, none below its least; else None."""
    fitted = list(widths)
    least = [max(min(name, have), min(_MIN_WIDTH, have)) for name, have in zip(least, widths, strict=True)]
    excess = sum(fitted) + 2 * (len(fitted) - 1) - width
    while excess > 0:
        column = max(range(len(fitted)), key=lambda i: fitted[i] - least[i])
        room = fitted[column] - least[column]
        if room <= 0:
            return None
        step = min(excess, max(room // 2, 1))
        fitted[column] -= step
        excess -= step
    return fitted


def cell_lines(cell: str | None, *, is_cut: bool) -> list[str]:
    """Return the lines of a cell with control characters escaped; sha256 ids are shortened to 16 digits."""
    if cell is None:
        return ["NULL"]
    if is_cut and _SHA256.fullmatch(cell):
        return [cell[:16]]
    lines = cell.rstrip("\n").split("\n") if cell else [""]
    visible = ("".join(c if c.isprintable() else ascii(c)[1:-1] for c in line) for line in lines)
    return [shorten(line, _MAX_CELL) if is_cut else line for line in visible]


def shorten(text: str, width: int) -> str:
    """Return the text in at most `width` characters."""
    return text if len(text) <= width else text[: width - 1] + "…"
