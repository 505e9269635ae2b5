"""One process each: ``inject``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.bus import check_endpoint, with_bus

if TYPE_CHECKING:
    from services.bus.session import BusOptions


@with_bus("inject", without=["listen", "mode"])
def inject(
    node: Annotated[str, typer.Argument(metavar="NODE", help="The node under test, which is alone at router B.")],
    b: Annotated[str, typer.Option("--to", metavar="ENDPOINT", help="Router B. Router A is the one of --connect.")],
    schedule: Annotated[
        Path | None, typer.Option("--schedule", metavar="FILE", help="TOML: one [[fault]] for each, times in s.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option("--fault", metavar="HARM,KEY,START,END[,SIZE[,SEED]]", help="One more; repeatable."),
    ] = None,
    *,
    bus: BusOptions,
) -> int:
    """Faults on the bus, injected between two routers.

    What passes is copied, and some of it harmed.
    Messages are lost, delayed, reordered, doubled, damaged, made NaN, stale, or stamped by a clock that jumped. Faults
    come from --schedule, from --fault and from the topic `inject`, while it runs. Times are vehicle times. With neither
    it copies everything, byte for byte.
    """
    from msgspec import structs

    from ltv_mpc.errors import ConfigError
    from services.bus.roles import ROLES
    from services.tools.faults import schedule as schedules

    if node not in ROLES:
        raise ConfigError("argument NODE", "", f"must be of {', '.join(ROLES)}", value=node)
    injections = [*([] if schedule is None else schedules.load(schedule)), *schedules.parse(fault or ())]
    check_endpoint("--to", b, bus.certs)
    from services.tools.faults import inject as process

    at_a = structs.replace(bus, mode="client")
    at_b = structs.replace(at_a, connect=(b,))
    return process.main(process.Config(node=node, injections=tuple(injections), at_a=at_a, at_b=at_b))
