"""Estimates from the autopilot's position and attitude, which are world NED and body FRD as here.

Position and attitude have different stamps. An estimate is made at each stamp of a position, with the attitude between
the two samples around it (linear; headings on the shorter way):

    heading rate = (q sin(roll) + r cos(roll)) / cos(pitch)

A reset of the EKF moves position or heading at once. No estimate is interpolated across one, and resets are counted.
The messages have no covariance: that of the settings is used.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ltv_mpc.messages import Array, Estimate
from services.edges.edge import Refused, wrapped

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
                yield self._estimate(position, heading, float(np.interp(position.ms, ms, rates)))

    def _estimate(self, position: _Position, heading_rad: float, rate_radps: float) -> Estimate:
        (north, east, down), (v_north, v_east, v_down) = position.place_m, position.velocity_mps
        return Estimate(
            t_ns=position.ms * MS,
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
