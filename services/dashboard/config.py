"""Config of the dashboard process; apart from the server, so that who starts it need not import that."""

from __future__ import annotations

import msgspec

from services.bus.session import BusOptions

SERVER = "services.dashboard.serve"


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """What the dashboard process needs to start."""

    bus: BusOptions
    host: str = "127.0.0.1"
    port: int = 0  # 0 takes any
    vehicle: str | None = None  # NAME or FILE: whose thrust limits are shown
    open_browser: bool = False
    gives_way: bool = False  # to the processes of a run: to be watched must cost the vehicle nothing
