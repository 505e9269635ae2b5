"""A vehicle that knows nothing of this project: a 6-DOF hull behind the messages of docs/protocol.md.

    l = M_vv v + M_vw w,   h = M_wv v + M_ww w                   momentum relative to the water, body frame
    l' + w x l = f,        h' + w x h + v x l = m                (Kirchhoff; Fossen 2011, eq 6.43)
    p' = R(q) v + v_c,     q' = q o [0, w] / 2

v (3,) velocity relative to the water, w (3,) turning rate, both forward, starboard, down; M rigid body and added mass;
q the attitude as a unit quaternion; v_c a current that is the same everywhere. f, m: thrusters, drag, fins at the
stern, and the righting couple of a neutral hull whose centre of gravity lies below that of its buoyancy. RK4 in steps
of 20 ms, in plain floats: numpy on three numbers is slower.

Thrusts come from propellers: a driver takes a command for that of the bollard pull and sets revolutions, which follow
with a lag; speed ahead takes thrust away.
"""

from __future__ import annotations

import json
import secrets
import sys
import time
from bisect import bisect_right
from math import atan2, copysign, cos, sin, sqrt
from typing import Any

import msgpack

STEP_NS = 20_000_000
STEP_S = 0.02

# --- the hull: 150 kg, 1.9 m long -------------------------------------------------------------------------------------

SURGE, SWAY, HEAVE = 158.0, 255.0, 260.0  # kg with added mass
ROLL, PITCH, YAW = 3.0, 62.0, 58.0  # kg m2 with added inertia
COUPLED = -4.0  # kg m of sway and yaw: ahead and astern of the middle its shape differs
LINEAR = (9.0, 55.0, 60.0, 5.0, 30.0, 15.0)
QUADRATIC = (25.0, 300.0, 330.0, 2.0, 90.0, 88.0)
RIGHTING_NM = 150.0 * 9.81 * 0.08  # a rad of roll or pitch
FIN, FIN_AFT_M = 60.0, 0.85  # lift FIN |u| v at the stern, on rudder and elevator fins that are fixed

# --- the thrusters ----------------------------------------------------------------------------------------------------

ARM_M, BELOW_M = 0.25, 0.01
BOLLARD = 0.09  # N s2: thrust = BOLLARD n |n| - LOST |n| u, n in rev/s
LOST = 0.22  # N s2/m
ASTERN = 0.75  # what the propeller is worth backwards
LAG_S = 0.22
DEAD_RPS = 1.0  # slower it does not turn at all
MIN_N, MAX_N, SLEW_N_PER_S = -38.0, 42.0, 80.0  # as its data sheet says
PLAN_TIMEOUT_NS = 5_000_000_000


class Hull:
    """Hull with the state position (m, NED), quaternion (w, x, y, z), v, w, revolutions of port and starboard (15,)."""

    def __init__(self, *, heading_rad: float = 0.0, current_mps: tuple[float, float] = (0.0, 0.0)) -> None:
        """Start at the origin, drifting with the water."""
        self.current = current_mps
        self.linear, self.quadratic, self.fin, self.righting_Nm = LINEAR, QUADRATIC, FIN, RIGHTING_NM
        self.shares = 1.0, 1.0  # of the thrust that reaches the water, which no report contains
        self.x = [0.0] * 15
        self.x[3], self.x[6] = cos(heading_rad / 2), sin(heading_rad / 2)

    @property
    def thrust_N(self) -> tuple[float, float]:
        """Delivered thrust of port and starboard."""
        return _thrust(self.x[13], self.x[7]), _thrust(self.x[14], self.x[7])

    def step(self, command_N: tuple[float, float]) -> None:
        """Advance by 20 ms under commands for port and starboard."""
        wanted = [_revolutions(command) for command in command_N]
        x, h = self.x, STEP_S
        a = self._rate(x, wanted)
        b = self._rate([s + 0.5 * h * d for s, d in zip(x, a, strict=True)], wanted)
        c = self._rate([s + 0.5 * h * d for s, d in zip(x, b, strict=True)], wanted)
        d = self._rate([s + h * d for s, d in zip(x, c, strict=True)], wanted)
        x = [s + h / 6.0 * (i + 2.0 * j + 2.0 * k + m) for s, i, j, k, m in zip(x, a, b, c, d, strict=True)]
        length = sqrt(sum(s * s for s in x[3:7]))
        self.x = [*x[:3], *(s / length for s in x[3:7]), *x[7:]]

    def _rate(self, x: list[float], wanted_rps: list[float]) -> list[float]:
        _, _, _, qw, qx, qy, qz, u, v, w, p, q, r, n1, n2 = x
        R = _rotation(qw, qx, qy, qz)
        port, starboard = self.shares[0] * _thrust(n1, u), self.shares[1] * _thrust(n2, u)
        f = [port + starboard, -self.fin * abs(u) * (v - FIN_AFT_M * r), -self.fin * abs(u) * (w + FIN_AFT_M * q)]
        m = [
            -self.righting_Nm * R[2][1],
            self.righting_Nm * R[2][0] + BELOW_M * (port + starboard) + FIN_AFT_M * f[2],
            ARM_M * (port - starboard) - FIN_AFT_M * f[1],
        ]
        terms = zip(self.linear, self.quadratic, (u, v, w, p, q, r), strict=True)
        drag = [-(one + two * abs(s)) * s for one, two, s in terms]
        l0, l1, l2 = SURGE * u, SWAY * v + COUPLED * r, HEAVE * w
        h0, h1, h2 = ROLL * p, PITCH * q, YAW * r + COUPLED * v
        f0 = f[0] + drag[0] - (q * l2 - r * l1)
        f1 = f[1] + drag[1] - (r * l0 - p * l2)
        f2 = f[2] + drag[2] - (p * l1 - q * l0)
        m0 = m[0] + drag[3] - (q * h2 - r * h1) - (v * l2 - w * l1)
        m1 = m[1] + drag[4] - (r * h0 - p * h2) - (w * l0 - u * l2)
        m2 = m[2] + drag[5] - (p * h1 - q * h0) - (u * l1 - v * l0)
        both = SWAY * YAW - COUPLED * COUPLED
        return [
            R[0][0] * u + R[0][1] * v + R[0][2] * w + self.current[0],
            R[1][0] * u + R[1][1] * v + R[1][2] * w + self.current[1],
            R[2][0] * u + R[2][1] * v + R[2][2] * w,
            0.5 * (-qx * p - qy * q - qz * r),
            0.5 * (qw * p + qy * r - qz * q),
            0.5 * (qw * q + qz * p - qx * r),
            0.5 * (qw * r + qx * q - qy * p),
            f0 / SURGE,
            (YAW * f1 - COUPLED * m2) / both,
            f2 / HEAVE,
            m0 / ROLL,
            m1 / PITCH,
            (SWAY * m2 - COUPLED * f1) / both,
            (wanted_rps[0] - n1) / LAG_S,
            (wanted_rps[1] - n2) / LAG_S,
        ]

    def estimate(self, t_ns: int) -> dict[str, Any]:
        """Return the estimate of a navigation system, with only the fields that the protocol requires."""
        R, (u, v, w) = _rotation(*self.x[3:7]), self.x[7:10]
        return {
            "t_ns": t_ns,
            "north_m": self.x[0],
            "east_m": self.x[1],
            "heading_rad": atan2(R[1][0], R[0][0]),
            "yaw_rate_radps": self.x[12],
            "velocity_north_mps": R[0][0] * u + R[0][1] * v + R[0][2] * w + self.current[0],
            "velocity_east_mps": R[1][0] * u + R[1][1] * v + R[1][2] * w + self.current[1],
        }


def _rotation(w: float, x: float, y: float, z: float) -> list[list[float]]:
    """Return the rotation matrix, body to world, of a unit quaternion."""
    return [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]


def _thrust(n: float, u: float) -> float:
    return (ASTERN if n < 0.0 else 1.0) * (BOLLARD * n * abs(n) - LOST * abs(n) * u)


def _revolutions(command_N: float) -> float:
    """Return the revolutions that the driver sets for a command."""
    n = copysign(sqrt(abs(command_N) / BOLLARD / (ASTERN if command_N < 0.0 else 1.0)), command_N)
    return n if abs(n) >= DEAD_RPS else 0.0


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


SET_AT_S = 20.0
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
                line = {"t_s": step * STEP_S, "north_m": hull.x[0], "east_m": hull.x[1], "epoch": epoch}
                sys.stdout.write(json.dumps({**line, "authority": plan["authority"]}) + "\n")
                sys.stdout.flush()
            due, step = due + STEP_NS, step + 1
            time.sleep(max(0, due - now_ns()) * 1e-9)


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
