"""Your vehicle: ``controller``, ``topics``; ``localise`` has a file of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.localise import localise
from services.cli.options import Connect, Json, Listen, Mode, Namespace, ReferenceFile, VehicleFile, ZenohConfig, bus


def register(app: typer.Typer, panel: str) -> None:
    """Add the commands to their panel."""
    app.command(rich_help_panel=panel)(controller)
    app.command(rich_help_panel=panel)(localise)
    app.command(rich_help_panel=panel)(topics)


def controller(
    vehicle: VehicleFile = "paper",
    reference: ReferenceFile = "descent",
    settings: Annotated[
        Path | None, typer.Option("--settings", metavar="FILE", help="The [controller] table alone, as TOML.")
    ] = None,
    compute_delay_s: Annotated[
        float, typer.Option("--compute-delay-s", metavar="D", help="Be slower by this much.", min=0, max=60)
    ] = 0.0,
    own_clock: Annotated[
        bool, typer.Option("--own-clock", help="Nobody publishes clock: count seconds from the start of this process.")
    ] = False,
    connect: Connect = None,
    listen: Listen = None,
    mode: Mode = None,
    config: ZenohConfig = None,
    namespace: Namespace = "",
) -> int:
    """The controller alone, against your publishers.

    Reads estimate and applied; writes plan.
    """
    from ltv_mpc import references
    from ltv_mpc.control.config import ControllerConfig
    from ltv_mpc.vehicle.parameters import Vehicle

    loaded = (
        Vehicle.load(vehicle),
        references.load(reference),
        ControllerConfig() if settings is None else ControllerConfig.load(str(settings)),
    )
    options = bus(connect, listen, mode, config, namespace)
    from services.nodes import controller as node

    return node.main(*loaded, options, compute_delay_s=compute_delay_s, own_clock=own_clock)


def topics(
    topic: Annotated[str | None, typer.Argument(metavar="[TOPIC]", help="A key: its fields and their types.")] = None,
    as_json: Json = False,
) -> int:
    """What travels; of one topic its fields.

    All topics: key, signal, period, delivery, sole writer, readers.
    """
    from services.views import topics as view

    typer.echo(view.text(topic, as_json=as_json), nl=False)
    return 0
