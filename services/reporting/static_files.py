"""Scripts and styles of page and report: written here, or in the installed plotly, whose JavaScript is one file."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent / "static"

NO_PLOTLY = "plotly is not installed"


class NoPlotly(Exception):
    """The extra ``viz`` is missing."""


def text(name: str) -> str:
    """One of this folder's files."""
    return (HERE / name).read_text(encoding="utf-8")


def plotly_path() -> Path:
    """plotly.min.js, found without importing plotly, which takes a second. Raises ``NoPlotly``."""
    spec = find_spec("plotly")
    for place in (spec.submodule_search_locations or ()) if spec is not None else ():
        path = Path(place) / "package_data" / "plotly.min.js"
        if path.is_file():
            return path
    raise NoPlotly(NO_PLOTLY)


@cache
def plotly() -> str:
    """The text of it."""
    return plotly_path().read_text(encoding="utf-8")
