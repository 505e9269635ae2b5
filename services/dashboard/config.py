"""Configuration of the dashboard process; separate from the server, so that its starter need not import the server."""

from __future__ import annotations

import msgspec

from services.bus.options import BusOptions

SERVER = "services.dashboard.serve"


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of the dashboard process."""

    bus: BusOptions
    host: str = "127.0.0.1"
    port: int = 0  # 0 takes any free port
    vehicle: str | None = None  # NAME or FILE of the vehicle whose thrust limits are shown
    open_browser: bool = False
    gives_way: bool = False  # lower the priority, so that the page takes no time from the processes of a run
