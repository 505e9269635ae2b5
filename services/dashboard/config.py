"""Configuration of the dashboard process; separate from the server, so that its starter need not import the server."""

from __future__ import annotations

import enum
from importlib.util import find_spec

import msgspec

from services.bus.options import BusOptions

SERVER = "services.dashboard.serve"
NEEDS = ("plotly", "starlette", "uvicorn", "websockets")


def missing_package() -> str:
    """Return which package of the page is not installed, and how to install it; empty if all are."""
    missing = next((name for name in NEEDS if find_spec(name) is None), "")
    return missing and f"{missing} is not installed: pip install {missing} (extra viz)"


class View(enum.StrEnum):
    """State of the page in a browser."""

    OPENED = "opened"
    DRAWN = "drawn"
    HAS_REPORT = "has report"
    CLOSED = "closed"  # by the last browser


class About(msgspec.Struct, frozen=True, kw_only=True):
    """Title of the page, and of a run the report and the command that repeats it."""

    name: str = ""  # title: scenario and vehicle; empty: the vehicle that publishes its settings
    bus: str = ""  # name of the bus, for a vehicle that publishes no settings
    report: str = ""  # file of the report
    again: str = ""  # command that runs the scenario again


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of the dashboard process."""

    bus: BusOptions = BusOptions()
    host: str = "127.0.0.1"
    port: int = 0  # 0 takes any free port
    vehicle: str | None = None  # NAME or FILE of the vehicle whose thrust limits are shown
    open_browser: bool = False
    about: About = About()
    of_a_run: bool = False
    """True if a run serves the page: it lowers its priority, so that it takes no time from the processes of the run. It
    reads what is being prepared, one line each, and writes what browsers do with it (``View``)."""
