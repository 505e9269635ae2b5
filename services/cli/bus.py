"""Panel "Your vehicle", on the bus: ``ctl`` commands a controller, ``topics`` lists messages, ``certs`` makes keys."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import typer

from services.cli.options import BusOptions, Force, Json, argument, flag, group, invalid, needs, option, with_bus

ActionName: TypeAlias = Literal[
    "arm", "disarm", "stop", "manual", "release", "follow", "hold", "fence", "clear", "source", "heartbeat"
]
"""Actions of commands to the controller, and the heartbeat of an operator."""

NO_FENCE = "none"

NEEDED = {"follow": "a reference, NAME or FILE,", "fence": f"a fence, FILE or `{NO_FENCE}`,"}
"""What an action needs."""


@with_bus("operator")
def ctl(
    action: Annotated[ActionName, argument("ACTION", "What the controller does, or `heartbeat`.")],
    file: Annotated[
        str | None,
        argument(
            "NAME|FILE",
            "follow: a reference, NAME or FILE. fence: a FILE (docs/fences.md), or `none`. source: its NAME, `default` "
            "for the plain key; without one, the order of the settings again.",
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
    from ltv_mpc.geofence.fence import Fence
    from ltv_mpc.messages import Action
    from ltv_mpc.node import DEFAULT_SOURCE

    if force and action != "arm":
        raise invalid("option --force", "only arm takes it", value=action)
    if action in NEEDED and file is None:
        raise invalid("argument ACTION", f"needs {NEEDED[action]} after it", value=action)
    if action not in (*NEEDED, "source") and file is not None:
        problem = "takes no file or name: only follow, fence and source do"
        raise invalid("argument ACTION", problem, value=action)
    from services.processes import operator as node

    if action == "heartbeat":
        return node.heartbeat(bus)
    fields, notes = dict[str, Any](force=force), list[str]()
    if action == "follow":
        fields["reference_toml"] = to_toml(references.load(file or "", notes))
    elif action == "fence":
        fields["fence_toml"] = "" if file == NO_FENCE else to_toml(Fence.load(file or "", notes))
    elif file is not None:
        from services.bus.topics import is_source_name

        if file != DEFAULT_SOURCE and not is_source_name(file):
            raise invalid("argument NAME", "must be 1 to 32 of a-z, 0-9, _ and -", value=file)
        fields["source"] = file
    for note in notes:
        typer.echo(note, err=True)
    return node.main(Action(action), fields, bus)


def topics(
    topic: Annotated[str | None, argument("TOPIC", "Key of one topic: list its fields and types.")] = None,
    as_json: Json = False,
    schema: Annotated[bool, flag("--schema", "Print the JSON Schema of the topic, or of all by key.")] = False,
) -> int:
    """List the topics of the bus, or the fields of one topic.

    The list has key, message type, period, delivery, the only writer, and the readers.
    """
    if schema and as_json:
        raise invalid("option --schema", "is JSON already: cannot act together with --json")
    from services.reporting import topics as view

    typer.echo(view.schemas(topic) if schema else view.text(topic, as_json=as_json), nl=False)
    return 0


SOURCE_NAME = "must be 1 to 32 of a-z, 0-9, _ and -, begin with a letter or digit, and not be `default`"

certs = group("certs", "Create keys and certificates for mTLS.")


@certs.command()
def new(
    folder: Annotated[Path, argument("DIR", "Folder to create.")],
    host: Annotated[
        list[str] | None, option("NAME", "Name or address of a router, in addition to loopback; repeatable.")
    ] = None,
    source: Annotated[
        list[str] | None, option("NAME", "Source of estimates on estimate/NAME, role estimator-NAME; repeatable.")
    ] = None,
    ros_domain: Annotated[
        list[int] | None, option("D", "ROS 2 domain, role ros-D; repeatable.", min=0, max=232)
    ] = None,
    days: Annotated[int, option("N", "Validity in days.", min=1, max=36500)] = 365,
    force: Force = False,
) -> int:
    """Create a certificate authority, and a key and certificate for every role.

    Copy to each host only ca.pem and the two files of each role that runs there, and to the router's host the .pem, not
    the .key, of each named source and each ROS 2 domain: it learns from them which there are.
    """
    from services.bus.roles import ROLES, ROS_PREFIX, SOURCE_PREFIX
    from services.bus.topics import is_source_name

    for name in host or ():
        if not re.fullmatch(r"[A-Za-z0-9.:-]{1,253}", name):
            raise invalid("option --host", "must be a host's name or address", value=name)
    for name in source or ():
        if not is_source_name(name):
            raise invalid("option --source", SOURCE_NAME, value=name)
    if folder.exists() and not folder.is_dir():
        raise invalid(f"folder {folder}", "is a file")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise invalid(f"folder {folder}", "is not empty; --force replaces the certificates in it")
    with needs("cryptography", "secure", "certs new"):
        from services.bus import certificates
    named = (
        *(SOURCE_PREFIX + name for name in source or ()),
        *(f"{ROS_PREFIX}{domain}" for domain in ros_domain or ()),
    )
    roles = list(dict.fromkeys((*ROLES, *named)))
    certificates.make(folder, roles, hosts=host or (), days=days)
    typer.echo(f"certificates of {len(roles)} roles, valid for {days} days: {', '.join(roles)}", err=True)
    typer.echo(str(folder))
    return 0
