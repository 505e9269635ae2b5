"""A vehicle that knows the messages of docs/protocol.md and nothing else of this project: a 6-DOF hull.

The hull, of 150 kg and 1.9 m, moves by the equations of the strangers (benchmarks/strangers/rigid_body.py), which share
none with the controller's model: its shape ahead and astern of the middle differs, fins at the stern are fixed, and a
righting couple keeps it upright. All else is its own: it packs and reads the messages itself.
"""

from __future__ import annotations

import json
import secrets
import sys
import time
from bisect import bisect_right
from math import remainder, sqrt, tau
from typing import Any

import msgpack
import numpy as np

from benchmarks.strangers import rigid_body

STEP_NS = 20_000_000
STEP_S = 0.02

SURGE, SWAY, HEAVE = 158.0, 255.0, 260.0  # kg with added mass
ROLL, PITCH, YAW = 3.0, 62.0, 58.0  # kg m2 with added inertia
COUPLED = -4.0  # kg m of sway and yaw
LINEAR = (9.0, 55.0, 60.0, 5.0, 30.0, 15.0)
QUADRATIC = (25.0, 300.0, 330.0, 2.0, 90.0, 88.0)
RIGHTING_NM = 150.0 * 9.81 * 0.08  # a rad of roll or pitch
MIN_N, MAX_N, SLEW_N_PER_S = -38.0, 42.0, 80.0  # as its data sheet says
BOLLARD, LOST = 0.09, 0.22  # thrust = BOLLARD n |n| - LOST |n| u, n in rev/s
PLAN_TIMEOUT_NS = 5_000_000_000

M = np.diag([SURGE, SWAY, HEAVE, ROLL, PITCH, YAW])
M[1, 5] = M[5, 1] = COUPLED
CRAFT = rigid_body.Hull(
    name="foreign",
    M=M,
    D=np.diag(LINEAR),
    quadratic=np.array(QUADRATIC),
    G=np.diag([0.0, RIGHTING_NM, RIGHTING_NM]),
    fin_kgpm=60.0,
    fin_m=-0.85,
    centre_of_gravity=(0.0, 0.0, 0.0),
    max_N=MAX_N,
    min_N=MIN_N,
    arms_m=(0.25, 0.25),
    lag_s=0.22,
    lost=LOST / sqrt(BOLLARD * MAX_N),
)


class Hull:
    """Simulated hull in steps of 20 ms; ``x`` is its state as ``rigid_body.Plant`` has it."""

    def __init__(self, *, heading_rad: float = 0.0, current_mps: tuple[float, float] = (0.0, 0.0)) -> None:
        """Start at the origin, drifting with the water."""
        self.plant = rigid_body.Plant(CRAFT, heading_rad=heading_rad, current_mps=current_mps)
        self.plant.velocity[:] = 0.0
        self.x = self.plant.state
        self._row = [0.0, 0.0, heading_rad, *current_mps, 0.0, 0.0, 0.0]

    @property
    def thrust_N(self) -> tuple[float, float]:
        """Delivered thrust of port and starboard."""
        return self._row[6], self._row[7]

    def step(self, command_N: tuple[float, float]) -> None:
        """Advance by 20 ms under commands for port and starboard."""
        self._row = self.plant.step(command_N, STEP_S).tolist()

    def estimate(self, t_ns: int) -> dict[str, Any]:
        """Return the estimate of a navigation system, with only the fields that the protocol requires."""
        _, _, heading, north_mps, east_mps, r, *_ = self._row
        return {
            "t_ns": t_ns,
            "north_m": float(self.x[0]),
            "east_m": float(self.x[1]),
            "heading_rad": remainder(heading, tau),
            "yaw_rate_radps": r,
            "velocity_north_mps": north_mps,
            "velocity_east_mps": east_mps,
        }


class Actuators:
    """Actuators that follow plans by the protocol's section on plans."""

    def __init__(self) -> None:
        """Start at rest, without a plan."""
        self.command_N = (0.0, 0.0)
        self._plans: list[dict[str, Any]] = []
        self._newest: dict[str, Any] = {"epoch": 0, "sequence": -1, "cycle_t_ns": 0, "t_ns": [0]}
        self._received_ns = 0
        self.late = self.rejected = 0

    def offer(self, plan: dict[str, Any], now_ns: int) -> None:
        """Add a plan that has arrived; it replaces the plans that start later."""
        starts = plan["t_ns"][0]
        self._plans = [p for p in self._plans if p["t_ns"][0] < starts] + [plan]
        self._newest, self._received_ns = plan, now_ns
        self.late += now_ns > starts

    def step(self, t_ns: int) -> tuple[float, float]:
        """Return the command at ``t_ns``, one step after the last one."""
        while len(self._plans) > 1 and self._plans[1]["t_ns"][0] <= t_ns:
            del self._plans[0]
        plan = self._plans[0] if self._plans else None
        target = (0.0, 0.0) if plan is None or t_ns < plan["t_ns"][0] else _between(plan, t_ns)
        port, starboard = (_towards(y, to) for y, to in zip(self.command_N, target, strict=True))
        self.command_N = (port, starboard)
        return self.command_N

    def report(self, t_ns: int, delivered_N: tuple[float, float]) -> dict[str, Any]:
        """Return the message ``applied``."""
        plan = self._newest
        return {
            "t_ns": t_ns,
            "thrust_N": [*delivered_N, 0.0],
            "command_N": [*self.command_N, 0.0],
            "command_slew_N_per_s": [0.0, 0.0, 0.0],
            "plan_epoch": plan["epoch"],
            "plan_sequence": plan["sequence"],
            "plan_cycle_t_ns": plan["cycle_t_ns"],
            "plan_received_t_ns": self._received_ns,
            "plan_late": plan["sequence"] >= 0 and self._received_ns > plan["t_ns"][0],
            "plans_late": self.late,
            "plans_rejected": self.rejected,
        }


def _between(plan: dict[str, Any], t_ns: int) -> tuple[float, float]:
    """Return the thrusts of port and starboard, linear between knots, and zero after 5 s or the last knot."""
    knots, thrust = plan["t_ns"], plan["thrust_N"]
    if t_ns >= min(knots[-1], knots[0] + PLAN_TIMEOUT_NS):
        return 0.0, 0.0
    i = bisect_right(knots, t_ns) - 1
    s = (t_ns - knots[i]) / (knots[i + 1] - knots[i])
    port, starboard = (thrust[i][k] + s * (thrust[i + 1][k] - thrust[i][k]) for k in range(2))
    return port, starboard


def _towards(y: float, target: float) -> float:
    reach = SLEW_N_PER_S * STEP_S
    return min(max(y + min(max(target - y, -reach), reach), MIN_N), MAX_N)


class Sender:
    """Sender that numbers messages by key and packs them."""

    def __init__(self) -> None:
        """Start a new epoch."""
        self.epoch = secrets.randbits(48)
        self._next: dict[str, int] = {}

    def pack(self, key: str, fields: dict[str, Any]) -> bytes:
        """Return the packed message for ``key``."""
        sequence = self._next.get(key, 0)
        self._next[key] = sequence + 1
        payload: bytes = msgpack.packb({"epoch": self.epoch, "sequence": sequence, **fields})
        return payload


AHEAD_NS = 7_200_000_000_000
"""Its clock: two hours ahead of the host's."""


SET_AT_S = 12.0
"""Time of its run at which its clock is set, if it is."""


def main(endpoint: str, set_by_s: float = 0.0) -> None:
    """Run in real time over Zenoh until it is ended; print a line of JSON each second and at each new controller.

    It arms the controller once.
    """
    import zenoh

    ahead_ns = AHEAD_NS

    def now_ns() -> int:
        return time.time_ns() + ahead_ns

    config = zenoh.Config()
    for key, value in (("mode", "client"), ("connect/endpoints", [endpoint]), ("scouting/multicast/enabled", False)):
        config.insert_json5(key, json.dumps(value))
    Hull().step((0.0, 0.0))  # loads compiled code, for which the first step in real time would wait
    hull, actuators, sender = Hull(heading_rad=1.0, current_mps=(0.12, -0.16)), Actuators(), Sender()
    hull.x[0], hull.x[1] = 1.5, -1.0
    with zenoh.open(config) as session:
        out = {
            key: session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
            for key in ("estimate", "applied", "command")
        }
        plans = session.declare_subscriber("plan", zenoh.handlers.FifoChannel(256))

        def send(key: str, fields: dict[str, Any]) -> None:
            out[key].put(sender.pack(key, fields))

        plan: dict[str, Any] = {"authority": "no plan", "epoch": 0}
        due, step, epoch, armed = now_ns(), 0, 0, False
        while True:
            if step * STEP_S == SET_AT_S:
                ahead_ns += round(set_by_s * 1e9)
                due += round(set_by_s * 1e9)
            while sample := plans.try_recv():
                plan = msgpack.unpackb(sample.payload.to_bytes())
                actuators.offer(plan, now_ns())
                send("applied", actuators.report(now_ns(), hull.thrust_N))
            hull.step(actuators.step(due))
            if step % 5 == 0:
                send("estimate", hull.estimate(due))
                send("applied", actuators.report(now_ns(), hull.thrust_N))
            armed = armed or plan["authority"] == "controller"
            if step % 50 == 0 and plan["authority"] == "disarmed" and not armed:
                send("command", {"command_id": step, "action": "arm"})
            if step % 50 == 0 or plan["epoch"] != epoch:
                epoch = plan["epoch"]
                line = {"t_s": step * STEP_S, "north_m": float(hull.x[0]), "east_m": float(hull.x[1]), "epoch": epoch}
                sys.stdout.write(json.dumps({**line, "authority": plan["authority"]}) + "\n")
                sys.stdout.flush()
            due, step = due + STEP_NS, step + 1
            time.sleep(max(0, due - now_ns()) * 1e-9)


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
