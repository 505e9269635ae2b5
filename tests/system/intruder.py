"""An intruder on a secured bus, written from Zenoh's manual: it imports nothing of the project.

    python intruder.py tls/HOST:PORT NAMESPACE CERTS FOREIGN_CERTS

CERTS is what it got hold of (of each role its certificate and key), FOREIGN_CERTS the same of another authority. It
goes on until its standard input closes, first with a line on its standard output that everything was sent once. Then it
prints what it has sent, by way, as JSON: ``denied`` for the router to stop, ``refused`` for the reader to refuse.
"""

from __future__ import annotations

import json
import random
import select
import sys
import time
from collections import deque
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgpack
import zenoh

ENDPOINT, NAMESPACE, CERTS, FOREIGN = sys.argv[1:]
KEPT = zenoh.CongestionControl.BLOCK  # every frame is to get as far as it can
WRONG_ROLE = 8000
REPLAYED = 1500
MALFORMED = 600
OVERSIZED = 20
FORGED_EPOCH = 0xBAD
MEBIBYTE = 1 << 20


def opened(folder: str | None, role: str, endpoint: str = ENDPOINT, patience_ms: int = 10_000) -> zenoh.Session:
    settings: dict[str, Any] = {
        "mode": "client",
        "scouting": {"multicast": {"enabled": False}},
        "connect": {"endpoints": [endpoint], "timeout_ms": patience_ms},
    }
    if folder is not None:
        own = {"root_ca_certificate": f"{folder}/ca.pem", "enable_mtls": bool(role)}
        if role:
            own |= {"connect_certificate": f"{folder}/{role}.pem", "connect_private_key": f"{folder}/{role}.key"}
        settings["transport"] = {"link": {"tls": own}}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))


def refused_connections() -> int:
    """Try connections that must be refused: no certificate, the role by another authority (trusted or not), no TLS."""
    both = Path(FOREIGN) / "mixed"  # believes the run's authority, shows the other's certificate
    both.mkdir(exist_ok=True)
    for folder, name in ((CERTS, "ca.pem"), (FOREIGN, "controller.pem"), (FOREIGN, "controller.key")):
        (both / name).write_bytes((Path(folder) / name).read_bytes())
    ways = [
        (CERTS, "", ENDPOINT),
        (FOREIGN, "controller", ENDPOINT),
        (str(both), "controller", ENDPOINT),
        (None, "", ENDPOINT.replace("tls/", "tcp/")),
    ]
    for folder, role, endpoint in ways:
        try:
            opened(folder, role, endpoint, patience_ms=300).close()
        except zenoh.ZError:
            continue
        sys.exit(f"it was let in: {folder}, {role}")
    return len(ways)


def overheard(keys: tuple[str, ...]) -> dict[str, list[bytes]]:
    """Collect frames of each key, for a replay when they are old."""
    frames: dict[str, deque[bytes]] = {key: deque(maxlen=50) for key in keys}
    with opened(CERTS, "display") as session:
        for key in keys:
            session.declare_subscriber(
                f"{NAMESPACE}/{key}", lambda sample, kept=frames[key]: kept.append(sample.payload.to_bytes())
            )
        while min(map(len, frames.values())) < 10:
            time.sleep(0.05)
    time.sleep(0.5)
    return {key: list(kept) for key, kept in frames.items()}


def forged(frame: bytes) -> bytes:
    """Return a frame that a reader would accept."""
    return msgpack.packb(msgpack.unpackb(frame) | {"epoch": FORGED_EPOCH, "sequence": random.randrange(10**6)})


def with_wrong_role(frames: dict[str, list[bytes]], open_ones: ExitStack) -> int:
    """Send valid frames, forged and replayed, under roles that may not send them, with a publisher and without.

    The sessions stay open: one that closes takes along what it has not sent yet.
    """
    ways = [(role, key) for role in ("display", "recorder", "sensors", "controller") for key in frames]
    ways = [(role, key) for role, key in ways if (role, key) != ("controller", "plan")]
    sent = 0
    for role, key in ways:
        session = open_ones.enter_context(opened(CERTS, role))
        publisher = session.declare_publisher(f"{NAMESPACE}/{key}", congestion_control=KEPT)
        while not publisher.matching_status.matching:
            time.sleep(0.01)
        for i in range(WRONG_ROLE // len(ways)):
            frame = random.choice(frames[key])
            publisher.put(frame if i % 2 else forged(frame))
            sent += 1
        session.put(f"{NAMESPACE}/{key}", forged(frames[key][0]), congestion_control=KEPT)
        session.delete(f"{NAMESPACE}/{key}", congestion_control=KEPT)
        sent += 2
    return sent


def with_stolen_key(estimates: list[bytes]) -> int:
    """Send with the estimator's own certificate: readers must reject replayed, broken and too large messages.

    All of them once, then replayed ones until the standard input closes: a reader may lose some of a flood.
    """
    fields = msgpack.unpackb(estimates[-1])
    wrong = [[1, 2, 3], *(fields | one for one in ({"north_m": float("nan")}, {"admin": True}, {"epoch": "x"}))]
    broken = [b"", b"\xc1", random.randbytes(200), estimates[-1][:-7], *map(msgpack.packb, wrong)]
    with opened(CERTS, "estimator") as session:
        publisher = session.declare_publisher(f"{NAMESPACE}/estimate", congestion_control=KEPT)
        while not publisher.matching_status.matching:
            time.sleep(0.01)
        for i in range(REPLAYED):
            publisher.put(estimates[i % len(estimates)])
        for i in range(MALFORMED):
            publisher.put(broken[i % len(broken)])
        for _ in range(OVERSIZED):
            publisher.put(bytes(3 * MEBIBYTE // 2))  # more than a message may have
        publisher.put(bytes(5 * MEBIBYTE))  # more than any session takes in
        print("sent once", flush=True)  # noqa: T201
        sent = REPLAYED + MALFORMED + OVERSIZED
        while not select.select([sys.stdin], [], [], 0.05)[0]:
            publisher.put(estimates[sent % len(estimates)])
            sent += 1
    return sent


def main() -> None:
    random.seed(0)
    frames = overheard(("plan", "estimate", "applied", "clock"))
    connections = refused_connections()
    with ExitStack() as open_ones:
        denied = with_wrong_role({**frames, "command": frames["clock"]}, open_ones)
        refused = with_stolen_key(frames["estimate"])
    print(json.dumps({"connections": connections, "denied": denied, "refused": refused}))  # noqa: T201


if __name__ == "__main__":
    main()
