"""Options of a bus connection: endpoints, mode, namespace and certificates."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec

ROUTER_ADDRESS = "127.0.0.1:7447"
"""Default address of the router, for nodes that connect and for a router that listens."""

SECURE = "tls"

HOST_AND_PORT = ("tcp", "udp", "tls", "quic", "ws")
PROTOCOLS = (*HOST_AND_PORT, "unixsock-stream")
"""Protocols of Zenoh's Python package. With another one Zenoh fails only after it has opened, or waits for ever."""

MAX_PORT = 2**16 - 1

Mode: TypeAlias = Literal["client", "peer", "router"]


def setting(metavar: str, about: str, *names: str, argument: bool = False, **bounds: Any) -> msgspec.Meta:
    """Return the description of a struct's field that is an option of the command line, or a positional argument.

    Parameters
    ----------
    metavar : value in help; empty for a flag.
    about : line of help.
    names : further names of the option.
    argument : True for a positional argument.
    bounds : ``ge`` and ``le``.
    """
    extra: dict[str, Any] = {"metavar": metavar or None, "names": names, "argument": argument}
    return msgspec.Meta(description=about, extra=extra, **bounds)


class BusOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Options of a process's bus connection: -e, -l, -m, -c, --namespace and --certs, named as in Zenoh."""

    connect: Annotated[
        tuple[str, ...],
        setting(
            "ENDPOINT",
            "Connect to this endpoint; repeatable. Default tcp/127.0.0.1:7447, with --certs tls/127.0.0.1:7447.",
            "-e",
        ),
    ] = ()
    listen: Annotated[
        tuple[str, ...], setting("ENDPOINT", "Listen on this endpoint as the router; repeatable.", "-l")
    ] = ()
    mode: Annotated[Mode | None, setting("MODE", "client, peer or router.", "-m")] = None
    config: Annotated[
        Path | None,
        setting("FILE", "Zenoh configuration file (JSON5). Default: $ZENOH_CONFIG, if it is set.", "-c"),
    ] = None
    namespace: Annotated[str, setting("NAME", "Prefix of every key: one for each vehicle.")] = ""
    certs: Annotated[
        Path | None,
        setting("DIR", "Use mTLS with the certificates in this folder; `ltv-mpc certs new DIR` creates them."),
    ] = None
    role: str = ""  # role of this process, whose certificate it uses
    timestamps: bool = False  # Zenoh stamps each message, as nodes of rmw_zenoh do; latched topics need it

    @property
    def acts_as(self) -> Mode:
        """Effective mode."""
        return self.mode or ("router" if self.listen else "client")

    @property
    def connects_to(self) -> tuple[str, ...]:
        """Effective endpoints; the default router for a client without any."""
        return self.connect or ((self.usual_endpoint,) if self.acts_as == "client" and not self._has_file else ())

    @property
    def usual_endpoint(self) -> str:
        """Endpoint of the default router."""
        return f"{SECURE if self.certs else 'tcp'}/{ROUTER_ADDRESS}"

    @property
    def _has_file(self) -> bool:
        return self.config is not None or "ZENOH_CONFIG" in os.environ


def endpoint_error(endpoint: str) -> str:
    """Return what is wrong with an endpoint such as ``tcp/127.0.0.1:7447``; empty if it is valid."""
    protocol, _, rest = endpoint.partition("/")
    address = re.split("[?#]", rest, maxsplit=1)[0]  # metadata and settings may follow it
    if not (protocol and address):
        return "must be PROTOCOL/ADDRESS, as in tcp/127.0.0.1:7447"
    if protocol not in PROTOCOLS:
        return f"the protocol must be one of {', '.join(PROTOCOLS)}"
    host, _, port = address.rpartition(":")
    number = int(port) if port.isascii() and port.isdigit() and len(port) <= 5 else 0
    if protocol in HOST_AND_PORT and not (host and 1 <= number <= MAX_PORT):
        return f"must be {protocol}/HOST:PORT, PORT from 1 to {MAX_PORT}"
    return ""
