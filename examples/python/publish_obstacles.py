"""A moving obstacle for the controller, by docs/protocol.md: publishes `obstacles`, a ferry that AIS reports.

    ltv-mpc router
    ltv-mpc controller --vehicle paper --reference REFERENCE.toml
    python publisher.py
    python publish_obstacles.py [tcp/127.0.0.1:7447]

Zenoh and msgpack, nothing else. In place of `ferry` stands your receiver of AIS, or your radar or sonar.
Reports have the time of the vehicle, at which the obstacle was there: the estimates have this time.
"""

import json
import math
import secrets
import signal
import sys

import msgpack
import zenoh

signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it without a traceback
PERIOD_NS = 10_000_000_000  # AIS reports a ship under way every 2 to 10 s, by its speed
SPEED_MPS, COURSE_DEG, LENGTH_M = 0.4, 90.0, 12.0
POSITION_SD_M = 3.0


def ferry(elapsed_s):
    """Return where the ferry is, and its velocity: north and east. It crosses 40 m north of the origin."""
    north_mps = SPEED_MPS * math.cos(math.radians(COURSE_DEG))
    east_mps = SPEED_MPS * math.sin(math.radians(COURSE_DEG))
    return 40.0 + elapsed_s * north_mps, -30.0 + elapsed_s * east_mps, north_mps, east_mps


def report(now, start):
    """Return the obstacle. Without `covariance_m2` its position would count as exact."""
    north, east, north_mps, east_mps = ferry((now - start) * 1e-9)
    return {
        "id": 257123456, "t_ns": now, "north_m": north, "east_m": east, "velocity_north_mps": north_mps,
        "velocity_east_mps": east_mps, "radius_m": 0.5 * LENGTH_M,
        "covariance_m2": [POSITION_SD_M**2, 0.0, POSITION_SD_M**2],
    }  # fmt: skip


routers = sys.argv[1:] or ["tcp/127.0.0.1:7447"]
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps(routers))
try:
    session = zenoh.open(config)
except zenoh.ZError:
    sys.exit(f"publish_obstacles.py: no router answers at {', '.join(routers)}: start one with `ltv-mpc router`")
with session:
    publisher = session.declare_publisher("obstacles")
    estimates = session.declare_subscriber("estimate", zenoh.handlers.FifoChannel(256))
    epoch, sequence, start, due = secrets.randbits(48), 0, None, 0
    while True:
        now = msgpack.unpackb(estimates.recv().payload.to_bytes())["t_ns"]
        start = now if start is None else start
        if now < due:
            continue
        due, ship = now + PERIOD_NS, report(now, start)
        obstacles = {"t_ns": now, "obstacles": [ship]}
        publisher.put(msgpack.packb({"epoch": epoch, "sequence": sequence, **obstacles}))
        sequence += 1
        print(f"{ship['north_m']:.1f} m north, {ship['east_m']:.1f} m east", flush=True)
