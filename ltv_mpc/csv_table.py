"""Tables of numbers as CSV: the one reader of currents, soundings and timed tracks.

The header names the columns, in any order; columns without a use are ignored. Lines that begin with # are comments. A
comment before the header that holds all needed names is the header: two published profiles have it there. Cells are
separated by commas, or by semicolons or tabs if the header is; then 0,5 is 0.5, and a table in which 1.000 may be a
thousand is an error.
"""

from __future__ import annotations

import contextlib
import csv
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from ltv_mpc import config
from ltv_mpc.errors import ConfigError, naming

Row: TypeAlias = dict[str, float]

BOUNDS = {
    "t_s": (0.0, 1e6, ""),
    "north_m": (-1e6, 1e6, ""),
    "east_m": (-1e6, 1e6, ""),
    "latitude_deg": (-89.0, 89.0, ""),
    "longitude_deg": (-180.0, 180.0, ""),
    "depth_m": (0.0, 11_000.0, " m, positive down"),
    # No ocean current is faster: larger numbers are in other units. Twice the largest current is no knowledge at all.
    "v_north_mps": (-5.0, 5.0, " m/s"),
    "u_east_mps": (-5.0, 5.0, " m/s"),
    "sd_mps": (0.0, 10.0, " m/s, a standard deviation"),
    "sd_common_mps": (0.0, 10.0, " m/s, a standard deviation"),
}
"""Smallest and largest number of each column, and its unit in errors."""

MAX_LINE = 100_000
"""Largest length of a line (characters). The module csv takes no longer cells."""
_WORD = re.compile(r"[\w.]+")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}([.,]\d{3})+")
"""Number whose marks may separate thousands."""


def read_table(
    path: Path,
    *alternatives: Sequence[str],
    what: str,
    source: str,
    optional: Sequence[str] = (),
    meanings: Mapping[str, str] | None = None,
    may_be_nan: Collection[str] = (),
    least: Row | None = None,
) -> dict[int, Row]:
    """Return the rows of a table by the number of their line.

    Parameters
    ----------
    path : the file.
    alternatives : names of the columns that are needed; of several such lists the one that the header has most of.
    what : kind of the file, for an error if it cannot be read.
    source : name of the file in all other errors.
    optional : names of the columns that are read if they are there.
    meanings : text behind the error about a missing column, by its name.
    may_be_nan : columns in which NaN, NA and an empty cell are numbers.
    least : smallest numbers by column, where they differ from ``BOUNDS``.

    Raises
    ------
    ConfigError
        If the file cannot be read or a row is not valid; with line, column, value and bound.
    """
    lines = config.read_text(path, what=what, errors="backslashreplace").splitlines()  # such as degree signs of Excel
    for k, text in enumerate(lines, start=1):
        if len(text) > MAX_LINE:
            raise ConfigError(source, f"line {k}", f"has {len(text)} characters: at most {MAX_LINE}")
    names, line, separator = _header(lines, alternatives, source)
    needed = max(alternatives, key=lambda names_: sum(name in names for name in names_))
    for name in needed:
        if name not in names:
            all_names = " or ".join(", ".join(one) for one in alternatives)
            names_wanted = f"; the header must name {all_names}, separated by commas, semicolons or tabs"
            known = (meanings or {}).get(name) or names_wanted
            raise ConfigError(source, f"line {line}", f"missing column {name}{known}")
    used = {name: names.index(name) for name in (*needed, *optional) if name in names}
    for name in used:
        if names.count(name) > 1:
            raise ConfigError(source, f"line {line}", f"column {name} occurs more than once")
    texts = {k: text for k, text in enumerate(lines[line:], start=line + 1) if text.strip(" \t")}
    table = {k: _cells(text, separator) for k, text in texts.items() if not _is_aside(text)}
    rows: dict[int, Row] = {}
    for k, cells in table.items():
        if any(cells[len(names) :]):
            problem = (
                f"has {len(cells)} cells, the header names {len(names)} columns: name each of them (write.table of "
                "R needs row.names = FALSE); decimal commas need cells and names separated by semicolons or tabs"
            )
            raise ConfigError(source, f"line {k}", problem)
        rows[k] = {
            name: _number(cells, at, f"line {k} {name}", separator, source, name in may_be_nan)
            for name, at in used.items()
        }
        with naming(source):
            check_bounds(rows[k], f"line {k} ", least)
    if separator != ",":
        _check_marks(table, used.values(), source)
    return rows


def check_bounds(values: Mapping[str, float], where: str, least: Mapping[str, float] | None = None) -> None:
    """Raise ``ValueError`` if a number is out of the bounds of its column.

    Parameters
    ----------
    values : numbers by the names of their columns.
    where : begins the error, with a space at its end.
    least : smallest numbers by column, where they differ from ``BOUNDS``.
    """
    for name, value in values.items():
        low, high, unit = BOUNDS[name]
        low = (least or {}).get(name, low)
        if value < low or value > high:
            raise ValueError(f"{where}{name} = {value:g}: must be >= {low:g} and <= {high:g}{unit}")


def _header(lines: Sequence[str], alternatives: Sequence[Sequence[str]], source: str) -> tuple[list[str], int, str]:
    """Return the names of the columns, the number of the header's line, and the separator of cells."""
    in_comment: tuple[list[str], int, str] | None = None
    for k, line in enumerate(lines, start=1):
        comment = line.lstrip().startswith("#")
        separator = next((mark for mark in ";\t" if mark in line), ",")
        names = _cells(line, separator)
        if comment:  # text may follow a name, so only the first word of each cell counts
            names = ["".join(_WORD.findall(cell)[:1]) for cell in line.split(separator)]
        complete = any(all(name in names for name in needed) for needed in alternatives)
        if comment:
            in_comment = in_comment or ((names, k, separator) if complete else None)
        elif line.strip() and not _is_aside(line):
            return in_comment if in_comment and not complete else (names, k, separator)
    if in_comment is None:
        raise ConfigError(source, "", f"missing header; it must name {', '.join(alternatives[0])}")
    return in_comment


def _is_aside(line: str) -> bool:
    """Return True for a comment, and for the line that names the separator to Excel."""
    return line.lstrip().startswith("#") or re.fullmatch("sep=.", line) is not None


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]


def _check_marks(table: Mapping[int, Sequence[str]], used: Iterable[int], source: str) -> None:
    """Reject points, or commas, that may separate thousands in every cell that has them."""
    for mark in ".,":
        marked = [(k, cells[at]) for k, cells in table.items() for at in used if mark in cells[at]]
        if marked and all(_THOUSANDS.fullmatch(cell) for _, cell in marked):
            (line, cell), decimal = marked[0], marked[0][1].replace(mark, ".")
            problem = f'"{mark}" may separate decimals or thousands: leave it out, or write one number as {decimal}0'
            raise ConfigError(source, f"line {line}", problem, value=cell)


def _number(cells: Sequence[str], position: int, field: str, separator: str, source: str, may_be_nan: bool) -> float:
    """Return the number in a cell."""
    if position >= len(cells):
        raise ConfigError(source, field, f"missing: column {position + 1} of a line that has {len(cells)}")
    cell, number = cells[position], math.nan
    with contextlib.suppress(ValueError):
        number = float(cell if separator == "," else cell.replace(",", "."))
    is_gap = may_be_nan and cell.lower() in ("nan", "na", "")
    if "_" in cell or not (math.isfinite(number) or is_gap):  # Python reads 1_0 as ten
        raise ConfigError(source, field, "must be a number, and finite", value=cell[:40])
    return number
