"""Places with further numbers from a table of comma-separated values, in metres or in degrees relative to an origin.

The first line is the header; columns are in any order and further ones are ignored. Lines that start with # are
comments.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.references.geodesy import Origin, Place, local

METRES = ("north_m", "east_m")
DEGREES = ("latitude_deg", "longitude_deg")
DEPTH = "depth_m"

_BOUNDS = {
    "t_s": (0.0, 1e6),
    "north_m": (-1e6, 1e6),
    "east_m": (-1e6, 1e6),
    "latitude_deg": (-89.0, 89.0),
    "longitude_deg": (-180.0, 180.0),
    DEPTH: (0.0, 11_000.0),
}


def read_places(
    path: Path, *, columns: tuple[str, ...], origin: Origin | None, rows: tuple[int, int], what: str, source: str
) -> dict[int, dict[str, float]]:
    """Return the rows of a table by the number of their line; each has ``north_m`` and ``east_m``.

    Parameters
    ----------
    path : the file.
    columns : names of the columns that it must have beside the places; ``depth_m`` is read if there is one.
    origin : position of north = east = 0; None is allowed for a table in metres.
    rows : smallest and largest number of rows.
    what : kind of the file, for an error if it cannot be read.
    source : name of the file in all other errors.

    Raises
    ------
    ConfigError
        If the file cannot be read or a row is not valid; with line, column, value and bound.
    """
    numbered = enumerate(config.read_text(path, what=what).splitlines(), start=1)
    lines = {k: line for k, line in numbered if line.strip() and not line.lstrip().startswith("#")}
    first = min(lines, default=None)
    header = {} if first is None else _header(lines.pop(first), columns, source)
    least, most = rows
    if len(lines) < least:
        raise ConfigError(source, "", f"needs a header and at least {least} rows of numbers")
    if len(lines) > most:
        raise ConfigError(source, "", f"has {len(lines)} rows: at most {most}")
    return {k: _row(line, f"line {k} ", header, origin, source) for k, line in lines.items()}


def check_bounds(values: Mapping[str, float], where: str) -> None:
    """Raise ``ValueError`` if a number is out of the bounds of its column.

    Parameters
    ----------
    values : numbers by the names of their columns.
    where : begins the error, with a space at its end.
    """
    for name, value in values.items():
        low, high = _BOUNDS[name]
        if not low <= value <= high:
            raise ValueError(f"{where}{name} = {value:g}: must be >= {low:g} and <= {high:g}")


def _header(line: str, columns: tuple[str, ...], source: str) -> dict[str, int]:
    """Return the positions of the columns by name."""
    names = [cell.strip() for cell in next(csv.reader([line]), [])]
    needed = (*columns, *(DEGREES if DEGREES[0] in names else METRES))
    for name in needed:
        if name not in names:
            optional = "" if DEPTH in columns else f", optionally {DEPTH}"
            known = f"{', '.join((*columns, *METRES))} (or {', '.join(DEGREES)}){optional}"
            raise ConfigError(source, "", f"missing column {name}; the header must name {known}")
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(source, "", f"column {name} occurs twice")
    return {name: names.index(name) for name in (*needed, DEPTH) if name in names}


def _row(line: str, where: str, header: dict[str, int], origin: Origin | None, source: str) -> dict[str, float]:
    """Return the numbers of a line by the names of their columns; degrees are replaced by metres."""
    cells = next(csv.reader([line]), [])
    values: dict[str, float] = {}
    for name, position in header.items():
        if position >= len(cells):
            raise ConfigError(
                source, f"{where}{name}", f"missing: column {position + 1} of a line that has {len(cells)}"
            )
        cell = cells[position].strip()
        try:
            values[name] = float(cell) if "_" not in cell else math.nan  # Python accepts 1_0 as ten
        except ValueError:
            values[name] = math.nan
        if not math.isfinite(values[name]):
            raise ConfigError(source, f"{where}{name}", "must be a number", value=cell[:40])
    try:
        check_bounds(values, where)
        if DEGREES[0] in values:
            latitude, longitude = (values.pop(name) for name in DEGREES)
            place = local(Place(latitude_deg=latitude, longitude_deg=longitude), origin)
            values |= dict(zip(METRES, place, strict=True))
    except ValueError as error:
        raise ConfigError(source, "", str(error)) from None
    return values
