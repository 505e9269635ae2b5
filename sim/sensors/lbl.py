"""Long baseline: the vehicle calls, each transponder answers, and the time there and back is measured.

Head    a(t) = p(t) + R(t) l;  transponder P_j, its turn-around time known and taken off
Sound   c = c0 + N(0, sd^2), drawn once: straight rays at one speed. What a filter is told is c0
There   tau_1 = |a(t0) - P| / c
Back    tau_2 = |a(t0 + tau_1 + tau_2) - P| / c        the vehicle has moved on meanwhile
Said    tau = tau_1 + tau_2 + 2 (N(0, sd_r^2) + m) / c0, valid at t0 + tau / 2, there at t0 + tau
        m = U(0, 1) outlier_m on a share of the answers: the sound that came by way of the surface or the bed goes
        further, never less far
Lost    a share of the answers, each transponder by itself; a call while the head is out of the water; a transponder
        further than a minute of sound, there and back, is not in reach
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.localisation.sensors.lbl import Lbl
from ltv_mpc.messages import MAX_TRAVEL_TIME_S, LblRange, Triple
from sim.random_streams import Stream, generator
from sim.sensors.outlier_masks import OutlierMasks
from sim.sensors.vehicle_state import Motion, VehicleState


class _Answer(NamedTuple):
    """On its way back."""

    called_ns: int
    transponder: int
    there_s: float  # tau_1
    error_s: float
    wild: bool


class AcousticTransceiver:
    """``sample`` calls and says nothing; ``answers`` are what comes back. ``outlier_masks`` has that of each, (1,)."""

    def __init__(self, settings: Lbl, seed: int) -> None:
        """The sound's speed is drawn first; noise, gaps and outliers of all transponders at each call."""
        self._settings, self._draws = settings, generator(seed, Stream.LBL)
        self.sound_speed_mps = settings.sound_speed_mps + settings.sound_speed_sd_mps * self._draws.standard_normal()
        self.outlier_masks = OutlierMasks()
        self._on_the_way: list[_Answer] = []

    def sample(self, now: VehicleState) -> list[LblRange]:
        """Call all transponders."""
        settings, count = self._settings, len(self._settings.transponders_m)
        # Everything is drawn at every call, so that no setting moves another's numbers.
        noise = settings.range_sd_m * self._draws.standard_normal(count)
        lost = self._draws.random(count) < settings.missing_share
        wild = self._draws.random(count) < settings.outlier_share
        detour = settings.outlier_m * self._draws.random(count)
        head = now.point_m(settings.lever_arm_m)
        if head[2] <= 0.0:
            return []
        error = 2.0 * (noise + np.where(wild, detour, 0.0)) / settings.sound_speed_mps
        for j in np.flatnonzero(~lost).tolist():
            there = self._one_way_s(head, j)
            self._on_the_way.append(_Answer(now.t_ns, j, there, float(error[j]), bool(wild[j])))
        return []

    def answers(self, motion: Motion, until_ns: int) -> list[LblRange]:
        """What has come back by ``until_ns``, to which ``motion`` reaches; to be asked of every motion in turn."""
        back: list[LblRange] = []
        waiting: list[_Answer] = []
        for answer in self._on_the_way:
            tau = self._time_s(answer, motion, until_ns)
            # t - t0 - tau(t) grows with t: the head is slower than sound. So it is back by now or it is not.
            if until_ns - answer.called_ns < tau * 1e9:
                if tau <= MAX_TRAVEL_TIME_S:
                    waiting.append(answer)
                continue
            for _ in range(3):  # each makes the error v / c of what it was
                tau = self._time_s(answer, motion, answer.called_ns + round(tau * 1e9))
            tau = max(tau + answer.error_s, 0.0)
            t_ns = answer.called_ns + round(0.5e9 * tau)
            self.outlier_masks.put(t_ns, np.array([answer.wild]))
            back.append(LblRange(t_ns=t_ns, transponder=answer.transponder, travel_time_s=tau))
        self._on_the_way = waiting
        return back

    def _time_s(self, answer: _Answer, motion: Motion, t_ns: int) -> float:
        """There and back, for a head that takes the answer where it is at ``t_ns``."""
        head = motion.at(t_ns).point_m(self._settings.lever_arm_m)
        return answer.there_s + self._one_way_s(head, answer.transponder)

    def _one_way_s(self, head: Triple, transponder: int) -> float:
        return math.dist(head, self._settings.transponders_m[transponder]) / self.sound_speed_mps


def arrival_ns(message: LblRange) -> int:
    """When it is heard: half the travel time after it is valid."""
    return message.t_ns + round(0.5e9 * message.travel_time_s)
