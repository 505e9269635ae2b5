"""Long baseline: the vehicle interrogates, each transponder answers, and the travel time there and back is measured.

Head    a(t) = p(t) + R(t) l;  transponder P_j, whose turn-around time is known and subtracted
Sound   c = c0 + N(0, sd^2), drawn once: straight rays at one speed. The filter assumes c0
There   tau_1 = |a(t0) - P| / c
Back    tau_2 = |a(t0 + tau_1 + tau_2) - P| / c        the vehicle has moved meanwhile
Message tau = tau_1 + tau_2 + 2 (N(0, sd_r^2) + m) / c0, valid at t0 + tau / 2, arrives at t0 + tau
        m = U(0, 1) outlier_m on a share of the answers: sound reflected by the surface or the bed travels further,
        never less far
Lost    a share of the answers, each transponder independently; an interrogation while the head is out of the water; a
        transponder is out of reach if its sound takes more than a minute there and back
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.localisation.sensors.lbl import Lbl
from ltv_mpc.messages import MAX_TRAVEL_TIME_S, LblRange, Triple
from sim.random_streams import Stream, generator
from sim.sensors.vehicle_state import Motion, VehicleState


class _Reply(NamedTuple):
    """Reply of a transponder that is still under way."""

    sent_ns: int  # time of the interrogation
    transponder: int
    there_s: float  # tau_1
    error_s: float


class AcousticTransceiver:
    """LBL transceiver of the vehicle."""

    def __init__(self, settings: Lbl, seed: int) -> None:
        """Draw the sound speed. Noise, losses and outliers of all transponders are drawn at each interrogation."""
        self._settings, self._draws = settings, generator(seed, Stream.LBL)
        self.sound_speed_mps = settings.sound_speed_mps + settings.sound_speed_sd_mps * self._draws.standard_normal()
        self._under_way: list[_Reply] = []

    def sample(self, now: VehicleState) -> list[LblRange]:
        """Interrogate all transponders; the ranges follow from ``answers``."""
        settings, count = self._settings, len(self._settings.transponders_m)
        # Everything is drawn at every interrogation, so that no setting changes the random numbers of another.
        noise = settings.range_sd_m * self._draws.standard_normal(count)
        lost = self._draws.random(count) < settings.missing_share
        outlier = self._draws.random(count) < settings.outlier_share
        detour = settings.outlier_m * self._draws.random(count)
        head = now.point_m(settings.lever_arm_m)
        if head[2] <= 0.0:
            return []
        error = 2.0 * (noise + np.where(outlier, detour, 0.0)) / settings.sound_speed_mps
        for j in np.flatnonzero(~lost).tolist():
            there = self._one_way_s(head, j)
            self._under_way.append(_Reply(now.t_ns, j, there, float(error[j])))
        return []

    def answers(self, motion: Motion, until_ns: int) -> list[LblRange]:
        """Return the ranges that arrive by ``until_ns``, the end of ``motion``. Call it for every motion in turn."""
        arrived: list[LblRange] = []
        waiting: list[_Reply] = []
        for reply in self._under_way:
            tau = self._time_s(reply, motion, until_ns)
            # t - t0 - tau(t) grows with t, because the head is slower than sound: the sign says if it has arrived.
            if until_ns - reply.sent_ns < tau * 1e9:
                if tau <= MAX_TRAVEL_TIME_S:
                    waiting.append(reply)
                continue
            for _ in range(3):  # each iteration multiplies the error by v / c
                tau = self._time_s(reply, motion, reply.sent_ns + round(tau * 1e9))
            tau = max(tau + reply.error_s, 0.0)
            t_ns = reply.sent_ns + round(0.5e9 * tau)
            arrived.append(LblRange(t_ns=t_ns, transponder=reply.transponder, travel_time_s=tau))
        self._under_way = waiting
        return arrived

    def arrival_ns(self, message: LblRange) -> int:
        """Return the time (ns) at which a range arrives: half its travel time after it is valid."""
        return message.t_ns + round(0.5e9 * message.travel_time_s)

    def _time_s(self, reply: _Reply, motion: Motion, t_ns: int) -> float:
        """Return the travel time there and back if the head receives the reply at ``t_ns``."""
        head = motion.at(t_ns).point_m(self._settings.lever_arm_m)
        return reply.there_s + self._one_way_s(head, reply.transponder)

    def _one_way_s(self, head: Triple, transponder: int) -> float:
        return math.dist(head, self._settings.transponders_m[transponder]) / self.sound_speed_mps
