"""Command ``ctl``: send a command to a running controller."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from services.cli.bus import with_bus
from services.cli.options import argument, flag, invalid

if TYPE_CHECKING:
    from services.bus.options import BusOptions

HEARTBEAT = "heartbeat"

NO_FENCE = "none"

NEEDED = {"follow": "a reference, NAME or FILE,", "fence": f"a fence, FILE or `{NO_FENCE}`,"}
"""What an action needs."""


@with_bus("operator")
def ctl(
    action: Annotated[
        str,
        argument("ACTION", "One of arm, disarm, stop, manual, release, follow, hold, fence, clear, source, heartbeat."),
    ],
    file: Annotated[
        str | None,
        argument(
            "NAME|FILE",
            "Reference for follow: a shipped name or a TOML file. Fence for fence: a TOML or GeoJSON file, or `none`. "
            "Source of estimates for source: its name, `default` for the plain key; without it, the order of the "
            "settings again.",
        ),
    ] = None,
    force: Annotated[bool, flag("--force", "Arm although pre-arm checks fail; prints what it skips.")] = False,
    *,
    bus: BusOptions,
) -> int:
    """Send a command to a running controller.

    Waits for the reply, at most 3 s. Exit code 1 and the reason if the controller rejects the command. `heartbeat`
    has no reply: it is sent once a second until Ctrl-C, as a sign that an operator is present.
    """
    from ltv_mpc import references
    from ltv_mpc.config import to_toml
    from ltv_mpc.errors import format_value
    from ltv_mpc.geofence.fence import Fence
    from ltv_mpc.messages import Action
    from ltv_mpc.node import DEFAULT_SOURCE
    from ltv_mpc.settings_schema import closest_name

    known = [*(one.value for one in Action), HEARTBEAT]
    if action not in known:
        meant = closest_name(action, known)
        near = f"; did you mean {format_value(meant)}?" if meant else ""
        raise invalid("argument ACTION", f"must be one of {', '.join(known)}{near}", value=action)
    if force and action != Action.ARM:
        raise invalid("option --force", "only arm takes it", value=action)
    if action in NEEDED and file is None:
        raise invalid("argument ACTION", f"needs {NEEDED[action]} after it", value=action)
    if action not in (*NEEDED, Action.SOURCE) and file is not None:
        problem = "takes no file or name: only follow, fence and source do"
        raise invalid("argument ACTION", problem, value=action)
    from services.processes import operator as node

    if action == HEARTBEAT:
        return node.heartbeat(bus)
    fields: dict[str, Any] = {"force": force}
    if action == Action.FOLLOW:
        fields["reference_toml"] = to_toml(references.load(file or ""))
    elif action == Action.FENCE:
        fields["fence_toml"] = "" if file == NO_FENCE else to_toml(Fence.load(file or ""))
    elif file is not None:
        from services.bus.topics import is_source_name

        if file != DEFAULT_SOURCE and not is_source_name(file):
            raise invalid("argument NAME", "must be 1 to 32 of a-z, 0-9, _ and -", value=file)
        fields["source"] = file
    return node.main(Action(action), fields, bus)
