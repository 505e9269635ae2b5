"""Places with further numbers from a CSV table, in metres or in degrees relative to an origin."""

from __future__ import annotations

from pathlib import Path

from ltv_mpc.csv_table import Row, read_table
from ltv_mpc.errors import ConfigError
from ltv_mpc.references.geodesy import DEGREES, DEPTH, METRES, Origin, Place, local


def read_places(
    path: Path,
    *columns: str,
    origin: Origin | None,
    rows: tuple[int, int],
    what: str,
    source: str,
    least: Row | None = None,
) -> dict[int, Row]:
    """Return the rows of a table by the number of their line; each has ``north_m`` and ``east_m``.

    Parameters
    ----------
    path : the file.
    columns : names of the columns that it must have beside the places; ``depth_m`` is read if there is one.
    origin : position of north = east = 0; None is allowed for a table in metres.
    rows : smallest and largest number of rows.
    what, source, least : as in ``csv_table.read_table``.

    Raises
    ------
    ConfigError
        If the file cannot be read or a row is not valid; with line, column, value and bound.
    """
    places, kinds = {}, ((*columns, *METRES), (*columns, *DEGREES))
    table = read_table(path, *kinds, what=what, source=source, optional=(DEPTH,), least=least)
    if not rows[0] <= len(table) <= rows[1]:
        problem = f"needs a header and at least {rows[0]} rows of numbers"
        raise ConfigError(source, "", problem if len(table) < rows[0] else f"has {len(table)} rows: at most {rows[1]}")
    for line, row in table.items():
        place = Place(**{name: row.pop(name) for name in (*METRES, *DEGREES) if name in row})
        try:
            places[line] = row | dict(zip(METRES, local(place, origin), strict=True))
        except ValueError as error:
            raise ConfigError(source, f"line {line}", str(error)) from None
    return places
