"""Start here: ``dashboard``."""

from __future__ import annotations

import ipaddress
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.bus import with_bus

if TYPE_CHECKING:
    from services.bus.session import BusOptions


@with_bus("operator")
def dashboard(
    port: Annotated[
        int, typer.Option("--port", metavar="P", help="Where the page is; 0: any free one.", min=0, max=65535)
    ] = 0,
    host: Annotated[
        str,
        typer.Option("--host", metavar="ADDRESS", help="An address of this machine; but loopback: open to others."),
    ] = "127.0.0.1",
    open_: Annotated[bool, typer.Option("--open", help="Open it in a browser.")] = False,
    vehicle: Annotated[
        str | None, typer.Option("--vehicle", metavar="NAME|FILE", help="Whose thrust limits are shown. Default: none.")
    ] = None,
    *,
    bus: BusOptions,
) -> int:
    """Watch any run, or your own vehicle, in a browser.

    Prints the page's address, with the token that its buttons need; without it the page is read-only.
    """
    from ltv_mpc.errors import ConfigError

    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise ConfigError("option --host", "", "must be an address, as 127.0.0.1", value=host) from None
    if address.is_unspecified:
        raise ConfigError("option --host", "", "must be one address, by which the page is then called", value=host)
    try:
        from services.dashboard import serve
        from services.dashboard.config import Config
    except ModuleNotFoundError as missing:
        typer.echo(f"dashboard: {missing.name} is not installed: the extra viz brings it", err=True)
        return 1
    from services.reporting.static_files import NoPlotly

    try:
        return serve.main(Config(bus=bus, host=host, port=port, vehicle=vehicle, open_browser=open_))
    except NoPlotly as missing:
        typer.echo(f"dashboard: {missing}: the extra viz brings it", err=True)
        return 1
