"""A vehicle of one's own behind the controller, by docs/protocol.md: publishes `estimate`, follows `plan`.

    ltv-mpc router
    ltv-mpc controller --vehicle paper --reference REFERENCE.toml
    python publisher.py [tcp/127.0.0.1:7447]
    ltv-mpc ctl arm

Zenoh and msgpack, nothing else. In place of `move` and `estimate` stand your thrusters and your navigation.
It stamps and follows by CLOCK_MONOTONIC, which also is the vehicle time that the project's estimator needs: a thruster
driver beside that estimator is this program with a publisher of `clock` in place of that of `estimate`.
"""

import json
import math
import secrets
import signal
import sys
import time

import msgpack
import zenoh

signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it without a traceback
PERIOD_S, SLEW_N_PER_S, PLAN_TIMEOUT_NS = 0.1, 100.0, 5_000_000_000


def target(plans, now):
    """Port and starboard (N): the newest plan that has begun, linear between its knots; zero after 5 s without one."""
    plan = next((plan for plan in reversed(plans) if plan["t_ns"][0] <= now), None)
    if plan is None or now >= min(plan["t_ns"][-1], plan["t_ns"][0] + PLAN_TIMEOUT_NS):
        return 0.0, 0.0
    i = max(k for k, knot in enumerate(plan["t_ns"]) if knot <= now)
    part = (now - plan["t_ns"][i]) / (plan["t_ns"][i + 1] - plan["t_ns"][i])
    before, after = plan["thrust_N"][i], plan["thrust_N"][i + 1]
    return tuple(a + part * (b - a) for a, b in zip(before[:2], after[:2], strict=True))


def follow(plans, plan, now):
    """Add a plan: the one in force stays until it begins, and it replaces those that would begin with it or later."""
    begun = [old for old in plans if old["t_ns"][0] <= now]
    waiting = [old for old in plans if now < old["t_ns"][0] < plan["t_ns"][0]]
    return [*begun[-1:], *waiting, plan]


def move(x, thrust):
    """Advance a vehicle without sideways drift by one period in still water: north, east, heading, speed, yaw rate."""
    port, starboard = thrust
    x["speed"] += PERIOD_S * (port + starboard - 500.0 * x["speed"] * abs(x["speed"])) / 500.0
    x["turn"] += PERIOD_S * (0.2 * (port - starboard) - (15.0 + 200.0 * abs(x["turn"])) * x["turn"]) / 180.0
    x["heading"] += PERIOD_S * x["turn"]
    x["north"] += PERIOD_S * x["speed"] * math.cos(x["heading"])
    x["east"] += PERIOD_S * x["speed"] * math.sin(x["heading"])


def estimate(x, now):
    """Return the estimate that the controller needs."""
    return {
        "t_ns": now, "north_m": x["north"], "east_m": x["east"], "heading_rad": x["heading"],
        "yaw_rate_radps": x["turn"], "velocity_north_mps": x["speed"] * math.cos(x["heading"]),
        "velocity_east_mps": x["speed"] * math.sin(x["heading"]),
    }  # fmt: skip


routers = sys.argv[1:] or ["tcp/127.0.0.1:7447"]
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps(routers))
try:
    session = zenoh.open(config)
except zenoh.ZError:
    sys.exit(f"publisher.py: no router answers at {', '.join(routers)}: start one with `ltv-mpc router`")
with session:
    publisher = session.declare_publisher("estimate", congestion_control=zenoh.CongestionControl.DROP)
    subscriber = session.declare_subscriber("plan", zenoh.handlers.FifoChannel(256))
    epoch, sequence, plans, thrust = secrets.randbits(48), 0, [], (0.0, 0.0)
    x = {"north": 3.0, "east": 0.0, "heading": 2.0, "speed": 0.0, "turn": 0.0}
    while True:
        now = time.monotonic_ns()
        while sample := subscriber.try_recv():
            plans = follow(plans, msgpack.unpackb(sample.payload.to_bytes()), now)
        most = SLEW_N_PER_S * PERIOD_S
        pairs = zip(thrust, target(plans, now), strict=True)
        thrust = tuple(y + min(max(wanted - y, -most), most) for y, wanted in pairs)
        move(x, thrust)
        publisher.put(msgpack.packb({"epoch": epoch, "sequence": sequence, **estimate(x, now)}))
        sequence += 1
        if sequence % 10 == 0:
            authority = plans[-1]["authority"] if plans else "no plan yet"
            print(f"{x['north']:.2f} m north, {x['east']:.2f} m east, {authority}", flush=True)
        time.sleep(max(0.0, PERIOD_S - (time.monotonic_ns() - now) * 1e-9))
