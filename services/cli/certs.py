"""Command ``certs``: keys and certificates for mTLS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import Force, argument, group, invalid, needs, option

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
    import re

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
