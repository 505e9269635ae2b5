"""Command ``ctl``: send a command to a running controller."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.bus import with_bus

if TYPE_CHECKING:
    from services.bus.options import BusOptions


@with_bus("operator")
def ctl(
    action: Annotated[
        str, typer.Argument(metavar="ACTION", help="One of arm, disarm, stop, manual, release, follow, hold.")
    ],
    file: Annotated[
        str | None, typer.Argument(metavar="[NAME|FILE]", help="Reference for follow: a shipped name or a TOML file.")
    ] = None,
    *,
    bus: BusOptions,
) -> int:
    """Send a command to a running controller.

    Waits for the reply, at most 3 s. Exit code 1 and the reason if the controller rejects the command.
    """
    from ltv_mpc import references
    from ltv_mpc.config import to_toml
    from ltv_mpc.errors import ConfigError, format_value
    from ltv_mpc.messages import Action
    from ltv_mpc.settings_schema import closest_name

    known = [one.value for one in Action]
    if action not in known:
        meant = closest_name(action, known)
        near = f"; did you mean {format_value(meant)}?" if meant else ""
        raise ConfigError("argument ACTION", "", f"must be one of {', '.join(known)}{near}", value=action)
    wanted = Action(action)
    if (file is not None) != (wanted is Action.FOLLOW):
        problem = "needs a reference, NAME or FILE, after it" if file is None else "takes no file: only follow does"
        raise ConfigError("argument ACTION", "", problem, value=action)
    toml = "" if file is None else to_toml(references.load(file))
    from services.processes import operator as node

    return node.main(wanted, toml, bus)
