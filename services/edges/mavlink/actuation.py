"""Thrusts as RC_CHANNELS_OVERRIDE of ArduPilot in mode MANUAL, and the way out of it: neutral, then release.

    us_i = table of thruster i at its thrust                  PWM of the thruster, [thruster.*] pwm_us and pwm_N
    u_i  = (us_i - 1500) / 400, within -1 and 1
    Rover   steering (channel 1) = (u_port - u_starboard) / 2,  throttle (3) = (u_port + u_starboard) / 2
    Sub     yaw (4) = (u_port - u_starboard) / 2,  forward (5) = (u_port + u_starboard) / 2,  up (3) = -u_vertical
    channel = 1500 + 400 x

This is the inverse of the skid steering of AR_Motors (left = throttle + steering, right = throttle - steering), which
never saturates here since |steering| + |throttle| = max |u_i|. It needs RCn_MIN 1100, RCn_TRIM 1500, RCn_MAX 1900, and
RCn_DZ 0. Sway (6) of Sub is not used. ArduPilot takes the throttle in whole percent.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Thruster, Vehicle
from services.edges.mavlink.autopilot import Kind

NEUTRAL, SPAN = 1500, 400
RELEASE, IGNORE = 0, 65535
CHANNELS = 8
NEUTRAL_US, RELEASE_US = 500_000, 1_000_000
"""Time of neutral and of release. Both are repeated in each period, because a frame may be lost."""

USED = {Kind.ROVER: (1, 3), Kind.SUB: (3, 4, 5)}
"""Channels that the edge overrides; it leaves the others to the pilot."""


def pwm_us(thruster: Thruster, thrust_N: float) -> float:
    """Return the PWM (us) of a thrust: linear in the table, constant beyond it, 1500 for no thrust.

    Thrusts that the table does not have ahead of, or behind, the dead band begin at its edge.
    """
    if thrust_N == 0.0:
        return float(NEUTRAL)
    us, force = np.asarray(thruster.pwm_us, dtype=float), np.asarray(thruster.pwm_N, dtype=float)
    if force[-1] < force[0]:
        us, force = us[::-1], force[::-1]
    # first and last row without thrust, the edges of the dead band; if there is none, last is the row before first
    first, last = np.searchsorted(force, 0.0, side="left"), np.searchsorted(force, 0.0, side="right") - 1
    side = slice(max(first, last), None) if thrust_N > 0.0 else slice(min(first, last) + 1)
    return float(np.interp(thrust_N, force[side], us[side]))


def channels(vehicle: Vehicle, kind: Kind, thrust_N: Array) -> dict[int, int]:
    """Return the PWM (us) of each overridden channel for thrusts (3,) in N."""
    u = [
        min(max((pwm_us(thruster, float(force)) - NEUTRAL) / SPAN, -1.0), 1.0) if thruster.pwm_us else 0.0
        for thruster, force in zip(vehicle.thrusters, thrust_N, strict=True)
    ]
    turn, ahead = 0.5 * (u[0] - u[1]), 0.5 * (u[0] + u[1])
    shares = {1: turn, 3: ahead} if kind is Kind.ROVER else {3: -u[2], 4: turn, 5: ahead}
    return {channel: round(NEUTRAL + SPAN * share) for channel, share in shares.items()}


class Overrides:
    """Sequence of the overrides. While the autopilot is disarmed nothing but the release is sent."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._neutral_until_us = -RELEASE_US  # then they are released

    def step(self, kind: Kind, thrust_N: Array | None, armed: bool, now_us: int) -> list[int] | None:
        """Return the 8 channels to send now, or None. ``thrust_N`` is None if the edge may not drive."""
        if thrust_N is not None and armed:
            self._neutral_until_us = now_us + NEUTRAL_US
            return self._row(channels(self._vehicle, kind, thrust_N))
        if not armed:
            self._neutral_until_us = min(self._neutral_until_us, now_us)
        if now_us < self._neutral_until_us:
            return self.neutral(kind)
        return self.release(kind) if self.acts(now_us) else None

    def acts(self, now_us: int) -> bool:
        """Return True until the channels have been released for a while."""
        return now_us < self._neutral_until_us + RELEASE_US

    def neutral(self, kind: Kind) -> list[int]:
        """Return the channels without thrust."""
        return self._row(dict.fromkeys(USED[kind], NEUTRAL))

    def release(self, kind: Kind) -> list[int]:
        """Return the channels that give the control back to the pilot."""
        return self._row(dict.fromkeys(USED[kind], RELEASE))

    def _row(self, values: dict[int, int]) -> list[int]:
        return [values.get(channel, IGNORE) for channel in range(1, CHANNELS + 1)]
