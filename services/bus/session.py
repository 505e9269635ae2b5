"""Zenoh session: configuration, publishers and subscribers. The only file that imports zenoh.

- No multicast and no scouting: a session is a client of a router, or itself the router if it listens. It waits for a
  lost router.
- Publishers drop under congestion and are not express: blocking ones stalled for seconds, express ones lost samples.
- All publishers have one priority: Zenoh keeps the order of one source only within a priority, and the record of a step
  must arrive before the step's outputs.
- Subscribers run on Zenoh's receiving thread and only append to one ``Mailbox``. Arrival across keys then has one
  order, and there is no intermediate FIFO that could fill and block the other keys, as that of Zenoh's default
  callback.
- Shared memory is off: by default it applies from 3 kB and can lose a chunk on busy cores.
- Queries and replies are dropped under congestion too. Much content is asked for in parts. A message that
  may not be dropped blocks a router's only thread, and with it all other links, while a receiver's queue is full.
  Zenoh's limit is 5 s and then closes that link; here it is ``MAX_BLOCKED_US``, for programs that send such messages.
- No session accepts a message larger than ``MAX_MESSAGE_BYTES``. Zenoh drops larger ones without a report, so this
  limit is above that of the message validation, which counts.
- Without certificates Zenoh's tasks share one thread. By default each kind of task has threads of its own, and each
  message wakes several of them, which took half as much processor time again (docs/notes/processor-time.md). A router
  has three: while it closes the link of a reader that is stuck with a full queue, it blocks one for up to 10 s. With
  certificates they keep their threads: a router logs each decision of its access control, and an intruder's many
  attempts would block the links of all others. $ZENOH_RUNTIME is kept if set.
- With certificates every link uses mutual TLS, and a listening session denies what no role allows.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, TypeAlias

import zenoh
import zenoh.ext

from ltv_mpc.errors import ConfigError
from services.bus import roles, security
from services.bus.options import BusOptions
from services.bus.topics import Topic, topic_at
from services.bus.wire import MAX_PAYLOAD_BYTES

MAX_MESSAGE_BYTES = 2 * MAX_PAYLOAD_BYTES
"""Largest message that a session accepts."""

MAX_BLOCKED_US = 100_000
"""Longest time for which a message that must not be dropped waits for a slow receiver, before its link is closed."""

RUNTIME = "ZENOH_RUNTIME"
"""Environment variable of Zenoh's threads, which Zenoh reads when the first session opens."""

_ELSEWHERE = ", ".join(f"{kind}: (handover: app)" for kind in ("acc", "net", "rx", "tx"))
THREADS, ROUTER_THREADS = (f"({_ELSEWHERE}, app: (worker_threads: {count}))" for count in (1, 3))

EXPLANATIONS = (
    ("Address already in use", "the address is in use: stop the process that listens there, or choose another port"),
    ("Cannot assign requested address", "this machine has no such address: listen at one that `ip address` shows"),
    ("No such device", "this machine has no such network interface: use one that `ip address` shows"),
    ("lookup address", "the host name is unknown: check its spelling, or use the IP address"),
    ("Permission denied", "not permitted: use a port from 1024 on, or a path that you may write"),
    ("No such file or directory", "the folder does not exist: create it, or use another path"),
    ("Too many open files", "the limit on open files is reached: raise it with `ulimit -n`"),
    ("TLS", "certificates are needed: --certs DIR; `ltv-mpc certs new DIR` makes them"),
)
"""Explanation of an error when a session is opened, by a part of Zenoh's text; the first one that fits is used."""


class BusError(RuntimeError):
    """Failure to open a session, for example because an address is in use."""


class Stopped(Exception):
    """Request to stop while a session waits for its router."""


def log_to_stdout(levels: str) -> None:
    """Make Zenoh log to standard output, with ``levels`` as in RUST_LOG; call it before the first session opens."""
    os.environ["RUST_LOG"] = levels
    zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]


def configuration(options: BusOptions) -> zenoh.Config:
    """Return Zenoh's configuration for these options. Raises ``ConfigError`` if Zenoh rejects it."""
    settings: dict[str, object] = {
        "transport/shared_memory/enabled": False,
        "transport/link/tx/queue/size/data": 16,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": MAX_BLOCKED_US,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    }
    try:
        if options.config is not None:
            config = zenoh.Config.from_file(str(options.config))
        elif "ZENOH_CONFIG" in os.environ:
            config = zenoh.Config.from_env()
        else:
            config = zenoh.Config()
            settings |= {
                "scouting/multicast/enabled": False,
                "scouting/gossip/enabled": False,
                "scouting/delay": 0,
                "mode": options.acts_as,
                "listen/endpoints": [],
                "connect/timeout_ms": -1,
                "connect/retry": {"period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 1.5},
            }
        chosen = {
            "mode": options.acts_as if options.mode or options.listen else None,
            "connect/endpoints": options.connects_to,
            "listen/endpoints": options.listen,
            "namespace": options.namespace,
            "timestamping/enabled": options.timestamps,
        }
        settings |= {key: value for key, value in chosen.items() if value}
        if options.certs is not None:
            settings["transport/link/tls"] = security.tls(security.credentials(options.certs, options.role))
            if options.acts_as == "router" or options.listen:
                prefixes = roles.SOURCE_PREFIX, roles.ROS_PREFIX
                others = [role for prefix in prefixes for role in security.roles_in(options.certs, prefix)]
                settings["access_control"] = roles.access_control(options.namespace, others)
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
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
    return ConfigError(source, "", f"Zenoh rejects the configuration: {_text(error)}", value=value)


def _text(error: BaseException) -> str:
    """Return Zenoh's error in one line, without its source location and its input."""
    text = re.sub(r" at /\S+\.rs:\d+\.?", "", str(error)).partition(", input: ")[0]
    return " ".join(text.split())


class FrameReceiver(Protocol):
    """Receiver of frames, usually a ``Mailbox``."""

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Take a frame. Called on Zenoh's thread, so it must return quickly."""
        ...


class Publisher(Protocol):
    """Publisher of one key."""

    def put(self, payload: bytes, *, attachment: bytes | None = None) -> None:
        """Publish a payload, with an attachment for the messages of other systems."""
        ...


ForeignReceiver: TypeAlias = Callable[[bytes, bytes], None]
"""Receiver of a message of another system: payload and attachment, on Zenoh's thread."""

Reply: TypeAlias = Callable[[bytes, bytes | None], None]
"""Function that replies to a query with a payload and an attachment."""

QueryReceiver: TypeAlias = Callable[[bytes, bytes, Reply], None]
"""Receiver of a query: payload, attachment, and the function that replies."""


class Session:
    """Open Zenoh session, closed by ``with``."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._subscribers: list[zenoh.Subscriber[None] | zenoh.Queryable[None] | zenoh.LivelinessToken] = []

    def publisher(self, key: str) -> Publisher:
        """Declare a publisher on ``key``."""
        drop, data = zenoh.CongestionControl.DROP, zenoh.Priority.DATA
        return self._session.declare_publisher(key, congestion_control=drop, priority=data, express=False)

    def subscribe(self, key: str, topic: Topic | None, receiver: FrameReceiver) -> None:
        """Offer each message that arrives on ``key`` to the receiver; ``topic`` None: looked up by the frame's key."""
        offer = receiver.offer

        def on_sample(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr)
            offer(topic or topic_at(name), name, sample.payload.to_bytes())

        self._subscribe(key, on_sample)

    def serve(self, key: str, receiver: QueryReceiver) -> None:
        """Pass the queries of ``key`` to the receiver."""

        def on_query(query: zenoh.Query) -> None:
            def reply(payload: bytes, attachment: bytes | None) -> None:
                with contextlib.suppress(zenoh.ZError):  # of a client that has gone
                    query.reply(query.key_expr, payload, attachment=attachment)
                query.drop()  # type: ignore[no-untyped-call]

            receiver(_bytes(query.payload), _bytes(query.attachment), reply)

        callback = zenoh.handlers.Callback(on_query, indirect=False)
        self._subscribers.append(self._session.declare_queryable(key, callback, complete=True))

    def ask(self, key: str, payload: bytes, *, timeout_s: float) -> bytes | None:
        """Query ``key`` and return the first reply; None without one in time, or when the session is closed."""
        try:
            drop = zenoh.CongestionControl.DROP  # for the replies too
            for reply in self._session.get(key, payload=payload, timeout=timeout_s, congestion_control=drop):
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
        except zenoh.ZError:
            pass
        return None

    # --- for edges: what ROS 2 over Zenoh needs ---

    @property
    def identifier(self) -> str:
        """Zenoh's identifier of this session."""
        return str(self._session.info.zid())

    def latched_publisher(self, key: str) -> Publisher:
        """Declare a publisher on ``key`` whose last message a later subscriber can query."""
        drop, cache = zenoh.CongestionControl.DROP, zenoh.ext.CacheConfig(max_samples=1)
        return zenoh.ext.declare_advanced_publisher(
            self._session, key, congestion_control=drop, cache=cache, publisher_detection=True
        )

    def receive(self, key: str, receiver: ForeignReceiver) -> None:
        """Pass what arrives on ``key`` to the receiver, with its attachment."""
        self._subscribe(key, lambda sample: receiver(sample.payload.to_bytes(), _bytes(sample.attachment)))

    def _subscribe(self, key: str, on_sample: Callable[[zenoh.Sample], None]) -> None:
        callback = zenoh.handlers.Callback(on_sample, indirect=False)
        self._subscribers.append(self._session.declare_subscriber(key, callback))

    def declare_token(self, key: str) -> None:
        """Declare a liveliness token, which ends with the session."""
        self._subscribers.append(self._session.liveliness().declare_token(key))

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for subscriber in self._subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._session.close()  # type: ignore[no-untyped-call]


def _bytes(data: zenoh.ZBytes | None) -> bytes:
    return b"" if data is None else data.to_bytes()


def open_session(options: BusOptions, *, stop: Callable[[], bool], say: Callable[[str], None]) -> Session:
    """Open a session and wait for the router without limit; after one second report through ``say``.

    Raises ``BusError`` if the session cannot be opened, and ``Stopped`` if ``stop`` returns True meanwhile.
    """
    config = configuration(options)
    if options.certs is None and os.environ.get(RUNTIME) in (None, THREADS, ROUTER_THREADS):  # perhaps the parent's
        os.environ[RUNTIME] = ROUTER_THREADS if options.acts_as == "router" else THREADS
    result: list[zenoh.Session | BaseException] = []

    def attempt() -> None:
        try:
            result.append(zenoh.open(config))
        except BaseException as error:  # a panic of Zenoh is no Exception
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
    if isinstance(opened, BaseException):
        raise BusError(_explained(options, _text(opened)))
    return Session(opened)


def _explained(options: BusOptions, text: str) -> str:
    """Say what Zenoh could not do, where, and what to do; Zenoh's own text if there is no explanation."""
    why = next((explanation for part, explanation in EXPLANATIONS if part in text), f"Zenoh reports: {text}")
    endpoints = options.listen or options.connects_to
    where = next((endpoint for endpoint in endpoints if endpoint in text), ", ".join(endpoints))
    does = "listen" if options.listen else "connect"
    return f"cannot {does} at {where or 'the configured endpoints'}: {why}"


def waiting_for_router(options: BusOptions) -> str:
    """Return the text that is shown while the router does not answer."""
    where = ", ".join(options.connects_to) or "the configured endpoints"
    command = "ltv-mpc router" if options.certs is None else "ltv-mpc router --certs DIR"
    if options.connects_to and options.usual_endpoint not in options.connects_to:
        command += f" --listen {options.connects_to[0]}"
    hint = "" if options.certs is None else "; a router that rejects this certificate reports it in its own log"
    return f"waiting for a router at {where}; `{command}` starts one{hint}"
