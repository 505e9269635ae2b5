"""Estimates from the autopilot's position, attitude and odometry, which are world NED and body FRD as here.

Position and attitude have different stamps. An estimate is made at each stamp of a position, with the attitude between
the two samples around it (linear; headings on the shorter way):

    heading rate = (q sin(roll) + r cos(roll)) / cos(pitch)

A reset of the EKF moves position or heading at once. No estimate is interpolated across one, and resets are counted.
LOCAL_POSITION_NED and ATTITUDE have no covariance: that of the settings is used. ODOMETRY has those of pose and twist,
as the 21 values of an upper triangle, row by row; one that is unknown begins with NaN, and is that of the settings.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import structs

from ltv_mpc.messages import Array, Estimate
from services.edges.edge import Refused
from services.edges.pose import covariance, rotation, wrapped

MS = 1_000_000  # ns
MAX_WAIT_MS = 500
"""Longest wait of a position for the attitude behind it."""

RESTART_MS = 5_000
"""Step of the stamps backwards that is a restart of the autopilot, and no reordering."""

JUMP_M, TURN_RAD = 1.0, 0.3
"""Motion beyond that of velocity and yaw rate that is a reset of the EKF."""

CONST_POSITION = 128  # EKF_CONST_POS_MODE
GAP_MS = 2_000
"""Gap of the positions behind which no jump can be told from motion."""


class Accuracy(msgspec.Struct, frozen=True):
    """Standard deviations of an autopilot that sends no covariance."""

    position_m: float = 1.0
    velocity_mps: float = 0.1
    heading_rad: float = 0.05
    yaw_rate_radps: float = 0.01

    @property
    def covariance(self) -> Array:
        """Covariance (6, 6) of an estimate."""
        deviations = (self.position_m,) * 2 + (self.velocity_mps,) * 2 + (self.heading_rad, self.yaw_rate_radps)
        covariance: Array = np.diag(np.square(deviations))
        return covariance

    @property
    def pose_and_twist(self) -> tuple[Array, Array]:
        """Covariances (6, 6) of position and rotation, and of velocity and angular velocity."""
        pairs = (self.position_m, self.heading_rad), (self.velocity_mps, self.yaw_rate_radps)
        pose, twist = (np.diag(np.square((linear,) * 3 + (0.0, 0.0, angular))) for linear, angular in pairs)
        return pose, twist


class _Attitude(NamedTuple):
    ms: int
    heading_rad: float
    rate_radps: float


class _Position(NamedTuple):
    ms: int
    place_m: tuple[float, float, float]
    velocity_mps: tuple[float, float, float]


class Navigation:
    """Estimates of one autopilot. ``resets`` counts those of its EKF, ``restarts`` its own."""

    def __init__(self, accuracy: Accuracy, *, dives: bool) -> None:
        """``dives``: the vehicle has a depth, down from the origin."""
        self._accuracy = accuracy
        self._dives = dives
        self._attitudes: deque[_Attitude] = deque(maxlen=50)
        self._waiting: deque[_Position] = deque(maxlen=20)
        self._last: _Position | None = None  # newest position
        self._odometry = False
        self._reset_counter = -1
        self.has_position = True
        """False while the EKF is in its mode of constant position: positions are refused."""
        self.resets = 0
        self.restarts = 0

    def attitude(self, message: Any) -> Iterator[Estimate]:
        """Add an ATTITUDE; yield the estimates that waited for it. Raises ``Refused``."""
        roll, pitch, yaw, q, r = _finite(message.roll, message.pitch, message.yaw, message.pitchspeed, message.yawspeed)
        sample = _Attitude(message.time_boot_ms, wrapped(yaw), _heading_rate(roll, pitch, q, r))
        if self._attitudes and not self._in_order(sample.ms, self._attitudes[-1].ms):
            return iter(())
        if self._attitudes:
            last = self._attitudes[-1]
            turned = wrapped(sample.heading_rad - last.heading_rad - last.rate_radps * (sample.ms - last.ms) * 1e-3)
            if sample.ms - last.ms < GAP_MS and abs(turned) > TURN_RAD:
                self._reset()
        self._attitudes.append(sample)
        return self._ready()

    def position(self, message: Any) -> Iterator[Estimate]:
        """Add a LOCAL_POSITION_NED; yield the estimates whose attitude is known. Raises ``Refused``."""
        if not self.has_position:
            raise Refused("position: the EKF has none")
        if self._odometry:
            raise Refused("position: the odometry is in use")
        x, y, z, vx, vy, vz = _finite(message.x, message.y, message.z, message.vx, message.vy, message.vz)
        sample = _Position(message.time_boot_ms, (x, y, z), (vx, vy, vz))
        last = self._last
        if last is not None and not self._in_order(sample.ms, last.ms):
            return iter(())
        if last is not None and sample.ms - last.ms < GAP_MS:
            dt = (sample.ms - last.ms) * 1e-3
            mean_mps = 0.5 * (np.array(sample.velocity_mps) + np.array(last.velocity_mps))
            way = np.array(sample.place_m) - np.array(last.place_m) - mean_mps * dt
            if float(np.linalg.norm(way)) > JUMP_M:
                self._reset()
        self._last = sample
        self._waiting.append(sample)
        return self._ready()

    def odometry(self, message: Any) -> Iterator[Estimate]:
        """Convert an ODOMETRY of the local NED frame, body FRD. Raises ``Refused``."""
        frame, body = message.frame_id, message.child_frame_id
        if frame not in (1, 20) or body != 12:  # LOCAL_NED, LOCAL_FRD; BODY_FRD
            raise Refused(f"odometry: frames {frame}, {body} must be local NED and body FRD")
        x, y, z, u, v, w, q, r = _finite(
            message.x, message.y, message.z, message.vx, message.vy, message.vz, message.pitchspeed, message.yawspeed
        )
        R = rotation(*_finite(*message.q))
        roll, pitch = math.atan2(R[2, 1], R[2, 2]), -math.asin(max(-1.0, min(1.0, R[2, 0])))
        rate = _heading_rate(roll, pitch, q, r)
        velocity, rates = R @ (u, v, w), R @ (*_finite(message.rollspeed), q, r)
        sample = _Position(message.time_usec // 1000, (x, y, z), (velocity[0], velocity[1], velocity[2]))
        heading = math.atan2(R[1, 0], R[0, 0])
        estimate = self._estimate(sample, heading, rate, message.time_usec * 1000)
        pose, twist = _matrix("pose", message.pose_covariance), _matrix("velocity", message.velocity_covariance)
        if pose is not None or twist is not None:
            assumed_pose, assumed_twist = self._accuracy.pose_and_twist
            turn, cos, sin = np.eye(6), math.cos(heading), math.sin(heading)
            turn[3:5, 3:5] = (cos, -sin), (sin, cos)  # roll and pitch are small, and about axes that have the heading
            pose = assumed_pose if pose is None else turn @ pose @ turn.T
            P = covariance(R, velocity, rates, pose, assumed_twist if twist is None else twist)
            estimate = structs.replace(estimate, covariance=P)
        return self._by_odometry(estimate, message.reset_counter)

    def _by_odometry(self, estimate: Estimate, reset_counter: int) -> Iterator[Estimate]:
        yield estimate
        if self._reset_counter not in (-1, reset_counter):  # it was accepted
            self.resets += 1
        self._reset_counter, self._odometry = reset_counter, True

    def _in_order(self, ms: int, newest_ms: int) -> bool:
        """Return False for a late or repeated sample. A large step backwards is a restart of the autopilot."""
        if ms < newest_ms - RESTART_MS:
            self.restarts += 1
            self._attitudes.clear()
            self._waiting.clear()
            self._last = None
            return True
        return ms > newest_ms

    def _reset(self) -> None:
        self.resets += 1
        self._attitudes.clear()
        self._waiting.clear()

    def _ready(self) -> Iterator[Estimate]:
        """Yield the estimates of the positions that have an attitude on either side."""
        while self._waiting and self._attitudes:
            position = self._waiting[0]
            newest = self._attitudes[-1]
            if position.ms > newest.ms:
                return
            self._waiting.popleft()
            if self._attitudes[0].ms <= position.ms and newest.ms - position.ms <= MAX_WAIT_MS:
                ms, headings, rates = zip(*self._attitudes, strict=True)
                heading = wrapped(float(np.interp(position.ms, ms, np.unwrap(headings))))
                yield self._estimate(position, heading, float(np.interp(position.ms, ms, rates)), position.ms * MS)

    def _estimate(self, position: _Position, heading_rad: float, rate_radps: float, t_ns: int) -> Estimate:
        (north, east, down), (v_north, v_east, v_down) = position.place_m, position.velocity_mps
        return Estimate(
            t_ns=t_ns,
            north_m=north,
            east_m=east,
            depth_m=down if self._dives else None,
            heading_rad=heading_rad,
            yaw_rate_radps=rate_radps,
            velocity_north_mps=v_north,
            velocity_east_mps=v_east,
            velocity_down_mps=v_down if self._dives else None,
            covariance=self._accuracy.covariance,
        )


def _heading_rate(roll: float, pitch: float, q: float, r: float) -> float:
    """Return the heading rate (rad/s) of body rates. Raises ``Refused`` where the heading is not defined."""
    if abs(pitch) > 1.4:
        raise Refused(f"pitch = {pitch:.2f} rad: the heading is not defined")
    return (q * math.sin(roll) + r * math.cos(roll)) / math.cos(pitch)


def _finite(*values: float) -> tuple[float, ...]:
    """Return the values. Raises ``Refused`` if one is not finite."""
    if not all(map(math.isfinite, values)):
        raise Refused("not a number, in position, velocity or attitude")
    return values


def _matrix(name: str, triangle: Sequence[float]) -> Array | None:
    """Return the covariance (6, 6) of an upper triangle, row by row; None if unknown. Raises ``Refused``."""
    if math.isnan(triangle[0]) or not any(triangle):
        return None
    P = np.zeros((6, 6))
    P[np.triu_indices(6)] = triangle
    P += np.triu(P, 1).T
    if not np.isfinite(P).all():
        raise Refused(f"odometry: {name} covariance has values that are not finite")
    return P
