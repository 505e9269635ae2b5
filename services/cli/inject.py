"""Command ``inject``: inject faults on the bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.bus import check_endpoint, with_bus

if TYPE_CHECKING:
    from services.bus.options import BusOptions


@with_bus("inject", without=["listen", "mode"])
def inject(
    node: Annotated[str, typer.Argument(metavar="NODE", help="Node under test, the only one at router B.")],
    b: Annotated[
        str, typer.Option("--to", metavar="ENDPOINT", help="Endpoint of router B. Router A is the one of --connect.")
    ],
    schedule: Annotated[
        Path | None,
        typer.Option(
            "--schedule", metavar="FILE", help="TOML file with one [[fault]] table for each fault, times in s."
        ),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            "--fault", metavar="FAULT", help="One more fault, HARM,KEY,START,END,SIZE,SEED; the last two are optional."
        ),
    ] = None,
    *,
    bus: BusOptions,
) -> int:
    """Inject faults on the bus, between two routers.

    Copies all messages between the routers and harms some of them: lost, delayed, reordered, doubled, damaged, NaN,
    stale, or stamped by a clock that jumped. Faults come from --schedule, --fault and the topic `inject`. Times are
    vehicle times. Without faults it copies everything byte for byte.
    """
    from msgspec import structs

    from ltv_mpc.errors import ConfigError
    from services.bus.roles import ROLES
    from services.tools.faults import schedule as schedules

    if node not in ROLES:
        raise ConfigError("argument NODE", "", f"must be one of {', '.join(ROLES)}", value=node)
    injections = [*([] if schedule is None else schedules.load(schedule)), *schedules.parse(fault or ())]
    check_endpoint("--to", b, bus.certs)
    from services.tools.faults import inject as process

    at_a = structs.replace(bus, mode="client")
    at_b = structs.replace(at_a, connect=(b,))
    return process.main(process.Config(node=node, injections=tuple(injections), at_a=at_a, at_b=at_b))
