"""Scripts and styles of the live page and the report: files of this folder, and the JavaScript of plotly."""

from __future__ import annotations

import string
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from services.reporting.plots.description import Group

HERE = Path(__file__).parent / "static"


class NoPlotly(Exception):
    """Error: plotly, part of the extra ``viz``, is not installed."""


def text(name: str) -> str:
    """Return the contents of a file of this folder."""
    return (HERE / name).read_text(encoding="utf-8")


def filled(template: str, **parts: str) -> str:
    """Return a template with its ``$parts`` filled in."""
    return string.Template(template).substitute(parts)


def safe_part(*, facts: str, processes: str, events: str, **page_only: str) -> str:
    """Return the first part of the live page and of the report, which answers whether the vehicle is safe.

    ``page_only`` are ``ages`` and ``command`` of the live page, ``sortable`` of the report.
    """
    parts = {"ages": "", "command": "", "sortable": "", **page_only}
    return filled(
        text("safe.html"), question=Group.SAFE.value, facts=facts, processes=processes, events=events, **parts
    )


def plotly_path() -> Path:
    """Return the path of plotly.min.js without importing plotly, which takes 1 s. Raises ``NoPlotly``."""
    spec = find_spec("plotly")
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        path = Path(folder) / "package_data" / "plotly.min.js"
        if path.is_file():
            return path
    raise NoPlotly("plotly is not installed: pip install plotly (extra viz)")


@cache
def report_scripts() -> tuple[str, str]:
    """Return the scripts of a report: plotly, and this project's. They are the same in every report."""
    return plotly_path().read_text(encoding="utf-8"), text("plots.js") + text("report.js")
