"""Command ``dashboard``: serve the live page."""

from __future__ import annotations

import ipaddress
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.bus import with_bus
from services.cli.options import ShownVehicle, flag, invalid, option

if TYPE_CHECKING:
    from services.bus.options import BusOptions


@with_bus("operator")
def dashboard(
    port: Annotated[int, option("P", "TCP port of the page; 0 takes any free one.", min=0, max=65535)] = 0,
    host: Annotated[
        str, option("ADDRESS", "Address of this machine; any but loopback opens the page to others.")
    ] = "127.0.0.1",
    open_: Annotated[bool, flag("--open", "Open the page in a browser.")] = False,
    vehicle: ShownVehicle = None,
    *,
    bus: BusOptions,
) -> int:
    """Watch any run, or your own vehicle, in a browser.

    Prints the address of the page with the token for its buttons; without the token the page is read-only.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise invalid("option --host", "must be an IP address such as 127.0.0.1", value=host) from None
    if address.is_unspecified:
        raise invalid(
            "option --host", "must be one address, not all of them: the page checks it in each request", value=host
        )
    try:
        from services.dashboard import serve
        from services.dashboard.config import Config
    except ModuleNotFoundError as missing:
        typer.echo(f"dashboard: {missing.name} is not installed: pip install {missing.name} (extra viz)", err=True)
        return 1
    from services.reporting.static_files import NoPlotly

    try:
        return serve.main(Config(bus=bus, host=host, port=port, vehicle=vehicle, open_browser=open_))
    except NoPlotly as missing:
        typer.echo(f"dashboard: {missing}: pip install plotly (extra viz)", err=True)
        return 1
