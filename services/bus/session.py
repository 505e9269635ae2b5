"""Zenoh, and all that was measured about it: the only file that imports it.

- No multicast, no scouting: a client of a router, or itself the router where it listens. A lost router is waited for.
- Publishers drop under congestion and are not express: blocking ones stalled for seconds, express ones lost samples.
- All publishers have one priority: Zenoh keeps the order of one source only within a priority, and a step's record has
  to arrive before the step's outputs.
- Subscribers run on Zenoh's receiving thread and only append to one ``Mailbox``: arrival across keys has one order, and
  no FIFO between can fill and hold up the other keys, as the default callback's does.
- Shared memory is off: by default it applies from 3 kB and can lose a chunk on busy cores.
- No session takes in a message of more than ``MAX_MESSAGE_BYTES``. Zenoh drops what is larger and says nothing, so this
  cap is above the door's own, which counts.
- With certificates every link is mTLS, and whoever listens denies what no role allows.
"""

from __future__ import annotations

import json
import os
import re
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Literal, Protocol, TypeAlias

import msgspec
import zenoh

from ltv_mpc.errors import ConfigError
from services.bus import roles, security
from services.bus.topics import Topic, topic_at
from services.bus.wire import MAX_PAYLOAD_BYTES

ROUTER_ADDRESS = "127.0.0.1:7447"
"""Where a node that is told nothing looks for a router, and where a router that is told nothing listens."""

SECURE = "tls"
MAX_MESSAGE_BYTES = 2 * MAX_PAYLOAD_BYTES

HOST_AND_PORT = ("tcp", "udp", "tls", "quic", "ws")
PROTOCOLS = (*HOST_AND_PORT, "unixsock-stream")
"""Those that Zenoh's Python package has; of another it only says so once it is open, or waits for ever."""

MAX_PORT = 2**16 - 1

Mode: TypeAlias = Literal["client", "peer", "router"]


class BusOptions(msgspec.Struct, frozen=True, kw_only=True):
    """-e, -l, -m, -c, --namespace, --certs: how a process reaches the others, in the words of Zenoh's users."""

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    mode: Mode | None = None  # default: router where it listens, client where it does not
    config: Path | None = None  # a Zenoh configuration; default: $ZENOH_CONFIG, if that is set
    namespace: str = ""  # put before every key: one per vehicle or run
    certs: Path | None = None  # the folder of certificates; every link is mTLS then
    role: str = ""  # as whom this process shows itself with them

    @property
    def acts_as(self) -> Mode:
        """The mode in force."""
        return self.mode or ("router" if self.listen else "client")

    @property
    def connects_to(self) -> tuple[str, ...]:
        """The endpoints in force: the usual router's where a client is told nothing."""
        return self.connect or ((self.usual_endpoint,) if self.acts_as == "client" and not self._has_file else ())

    @property
    def usual_endpoint(self) -> str:
        """The usual router's."""
        return f"{SECURE if self.certs else 'tcp'}/{ROUTER_ADDRESS}"

    @property
    def _has_file(self) -> bool:
        return self.config is not None or "ZENOH_CONFIG" in os.environ


def endpoint_error(endpoint: str) -> str:
    """What is wrong with ``tcp/127.0.0.1:7447``; empty where nothing is."""
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


class BusError(RuntimeError):
    """A session that cannot be opened: an address that is taken."""


class Stopped(Exception):
    """The process was told to stop while it waited."""


def log_to_stdout(levels: str) -> None:
    """Have Zenoh log what ``levels``, in the words of RUST_LOG, asks for; before the first session opens."""
    os.environ["RUST_LOG"] = levels
    zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]


def configuration(options: BusOptions) -> zenoh.Config:
    """Zenoh's configuration for these options. Raises ``ConfigError`` where Zenoh refuses it."""
    try:
        if options.config is not None:
            config = zenoh.Config.from_file(str(options.config))
        elif "ZENOH_CONFIG" in os.environ:
            config = zenoh.Config.from_env()
        else:
            config = zenoh.Config()
            _insert(config, "scouting/multicast/enabled", False)
            _insert(config, "scouting/gossip/enabled", False)
            _insert(config, "scouting/delay", 0)
            _insert(config, "mode", options.acts_as)
            _insert(config, "listen/endpoints", [])
            _insert(config, "connect/timeout_ms", -1)
            _insert(
                config,
                "connect/retry",
                {"period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 1.5},
            )
        if options.mode is not None or options.listen:
            _insert(config, "mode", options.acts_as)
        if options.connects_to:
            _insert(config, "connect/endpoints", list(options.connects_to))
        if options.listen:
            _insert(config, "listen/endpoints", list(options.listen))
        if options.namespace:
            _insert(config, "namespace", options.namespace)
        _insert(config, "transport/shared_memory/enabled", False)
        _insert(config, "transport/link/tx/queue/size/data", 16)
        _insert(config, "transport/link/rx/max_message_size", MAX_MESSAGE_BYTES)
        if options.certs is not None:
            _insert(config, "transport/link/tls", security.tls(security.credentials(options.certs, options.role)))
            if options.acts_as == "router" or options.listen:
                _insert(config, "access_control", roles.access_control(options.namespace))
    except zenoh.ZError as error:
        raise _refusal(options, error) from None
    return config


def _refusal(options: BusOptions, error: zenoh.ZError) -> ConfigError:
    if options.config is not None:
        source, value = "option --config", str(options.config)
    elif "ZENOH_CONFIG" in os.environ:
        source, value = "$ZENOH_CONFIG", os.environ["ZENOH_CONFIG"]
    else:
        source, value = "bus options", " ".join((*options.connect, *options.listen, options.namespace))
    return ConfigError(source, "", f"Zenoh rejects the configuration: {_words(error)}", value=value)


def _words(error: zenoh.ZError) -> str:
    """What Zenoh says, in one line and without where in its sources it says so, or the file that it was given."""
    text = re.sub(r" at /\S+\.rs:\d+\.?", "", str(error)).partition(", input: ")[0]
    return " ".join(text.split())


def _insert(config: zenoh.Config, key: str, value: object) -> None:
    config.insert_json5(key, json.dumps(value))


class FrameReceiver(Protocol):
    """Where what arrives is put: a ``Mailbox``, as a rule."""

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Called on Zenoh's thread: be quick."""
        ...


class Publisher:
    """One key's way out."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self.put: Callable[[bytes], None] = publisher.put


class Session:
    """An open Zenoh session; close it by ``with``."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._subscribers: list[zenoh.Subscriber[None]] = []

    def publisher(self, key: str) -> Publisher:
        """A way out on ``key``."""
        return Publisher(
            self._session.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA,
                express=False,
            )
        )

    def subscribe(self, key: str, topic: Topic | None, inlet: FrameReceiver) -> None:
        """Hand over what arrives on ``key``. ``topic`` None: the table's row of each message's own key."""
        offer = inlet.offer

        def arrived(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr)
            offer(topic or topic_at(name), name, sample.payload.to_bytes())

        self._subscribers.append(
            self._session.declare_subscriber(key, zenoh.handlers.Callback(arrived, indirect=False))
        )

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for subscriber in self._subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]  # zenoh leaves both without a type
        self._session.close()  # type: ignore[no-untyped-call]


def open_session(options: BusOptions, *, stop: Callable[[], bool], say: Callable[[str], None]) -> Session:
    """Open, and wait for the router as long as it takes; after a second ``say`` what is waited for.

    Raises ``BusError`` where waiting would not help, and ``Stopped`` when ``stop`` turns true meanwhile.
    """
    config = configuration(options)
    result: list[zenoh.Session | zenoh.ZError] = []

    def attempt() -> None:
        try:
            result.append(zenoh.open(config))
        except zenoh.ZError as error:
            result.append(error)

    # Zenoh's open cannot be interrupted by a signal; a daemon thread can be left behind.
    thread = threading.Thread(target=attempt, name="open", daemon=True)
    thread.start()
    thread.join(1.0)
    if thread.is_alive():
        say(waiting_for_router(options))
    while thread.is_alive():
        if stop():
            raise Stopped
        thread.join(0.1)
    (opened,) = result
    if isinstance(opened, zenoh.ZError):
        raise BusError(f"Zenoh cannot open a session: {_words(opened)}")
    return Session(opened)


def waiting_for_router(options: BusOptions) -> str:
    """What a person reads while nobody answers."""
    where = ", ".join(options.connects_to) or "the configured endpoints"
    command = "`ltv-mpc router`" if options.certs is None else "`ltv-mpc router --certs`"
    refused = "" if options.certs is None else "; a router that rejects this certificate reports it in its own log"
    return f"waiting for a router at {where}; {command} starts one at {options.usual_endpoint}{refused}"
