"""Command ``watch``: show the state of a run or of a vehicle in the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.cli.bus import with_bus
from services.cli.options import ShownVehicle

if TYPE_CHECKING:
    from services.bus.options import BusOptions


@with_bus("display")
def watch(vehicle: ShownVehicle = None, *, bus: BusOptions) -> int:
    """Watch any run, or your own vehicle, in the terminal.

    Fits 80 x 24 characters, so that it works over ssh. It only reads. In a pipe it prints a line every 5 s.
    """
    from services.tools import watch as screen

    return screen.main(bus, vehicle)
