"""Whether the vehicle does what its model says: the motion from one estimate to the next, seen less foreseen.

Impulses over dt from one estimate to the next, by the thrusts F that the actuators report (port a1, starboard a2):

    I_i = integral of F_i                                                                       N s
    X   = I_1 + I_2       - d_x(u) dt   + M_y v r dt - m [ cos psi, sin psi] . dc               surge
    N   = a1 I_1 - a2 I_2 - d_psi(r) dt + (M_x - M_y) u v dt                                    yaw
    z_x = X - M_x du,   z_n = N - I_z dr                                                        what is missing

with d_x(u) = (d_x + D_x |u|) u and d_psi(r) likewise. Of thrusters that deliver (1 - l_i) of what they report, on a
vehicle whose drag is (1 + b) times the model's, in units of its true mass:

    z_x = l_1 I_1    + l_2 I_2    + b d_x dt   + e_x,    e_x ~ N(0, M_x^2 (q^2 + P_v0 - P_v1 + 2 P_v1 dt/tau))
    z_n = a1 l_1 I_1 - a2 l_2 I_2 + b d_psi dt + e_n,    e_n ~ N(0, I_z^2 (p^2 + P_r0 + P_r1))

q, p are the noise of the velocity's and the yaw rate's change; a filter that corrects its velocity says so by its
variance P_v, which falls, and what it is wrong by moves within its P_v, over tau. The yaw rate's own noise P_r is new
in each estimate, so e_n takes back at each what it gave at the one before (``evidence.whitened``): over a window it is
that of two estimates, not of all.

The alarm is given at ``ALARM`` nats of evidence that l has grown, beyond what 10 % of mismatch can make and what the
vehicle has done so far (``thrust_loss_detector.py``). While it is on, nothing is learned of the vehicle.

It needs reports of the actuators and estimates with a current. A surge of the water that the estimate does not know
of, or a tow, is not told from thrust: it is wrong all the same.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ltv_mpc.control.prediction import current_at_depth
from ltv_mpc.messages import Applied, Array, Estimate, ModelCheck, Pair
from ltv_mpc.safety.thrust_loss_detector import WINDOWS, learn, weigh
from ltv_mpc.vehicle.parameters import Vehicle

ALARM = 12.0
"""Nats. e^-12 a look, of which a run of 200 s has 700: one false alarm in 200 runs that are all at the worst edge."""

QUIET = 10
"""Cycles without evidence after which an alarm is over; the longest window must have left the loss behind besides."""

WANDERS_S = 3.0
"""tau. With realistic sensors a velocity is known to 1 cm/s while biases of the profiler are learned: taken to be wrong
by the same all the time, it gave a false alarm in 12 of 24 runs with mismatch, in their first half minute.
"""

NOISE_RADPS = 2e-4
"""p: what a gyro's bias and the trapezoids leave of the yaw rate's change."""

LONGEST_S = 1.0
"""Over a longer time from estimate to estimate the trapezoids say too little."""

WORD_NS = 1_000_000_000

SETTLES_S, SETTLING_MPS = 5.0, 8e-3
"""After its first thrust, at the start of a descent, a filter's velocity moves by so much from one estimate to the next
while the last satellite fixes and the first pings find together, and its variance does not say so. Its yaw rate does
not, and tells what the thrusters do.
"""


class _Seen(NamedTuple):
    """One estimate, and the impulses of all reports up to its time."""

    t_ns: int
    u: float
    v: float
    r: float
    heading: float
    current: Pair
    impulse: Pair
    variance: Pair  # of a velocity's component, of the yaw rate


class ModelMonitor:
    """Watches one vehicle's thrusts by how it moves."""

    def __init__(self, vehicle: Vehicle, noise_mps: float, settles_s: float = SETTLES_S) -> None:
        """``noise_mps`` is q; in the first ``settles_s`` of thrust it is ``SETTLING_MPS`` besides."""
        self._unsettled_s = settles_s
        self._p = vehicle.coefficients()
        self._noise = (self._p.mass_surge * noise_mps) ** 2
        self._reports: deque[tuple[int, Pair, Pair]] = deque(maxlen=32)  # time, thrusts, impulses up to then
        self._seen: _Seen | None = None
        self._rows = np.empty((WINDOWS[-1], 5, 2))  # the newest first
        self._cycles = 0  # of them
        self._known = np.zeros((4, 4))  # of the vehicle, by all rows before
        self._residual = [0.0, 0.0, 0.0]  # N s, N m s and s since the last word
        self._said_ns: int | None = None
        self._quiet = 0
        self.evidence = 0.0
        self.alarm = False
        self.loss: Pair = (0.0, 0.0)

    @property
    def products(self) -> Array | None:
        """What is known of the vehicle (``evidence.learn``), its own copy; None before anything is."""
        return self._known.copy() if self._known.any() else None

    def restore(self, products: Array) -> None:
        """Go on from what another one had ``learned`` of the same vehicle, in a dive that has settled."""
        self._known[...] = products
        self._unsettled_s = 0.0

    def report(self, applied: Applied) -> None:
        """The actuators say what they deliver."""
        thrust = applied.thrust_N[:2]
        if not self._reports:
            self._reports.append((applied.t_ns, thrust, (0.0, 0.0)))
            return
        t_ns, before, impulse = self._reports[-1]
        half_s = 0.5e-9 * (applied.t_ns - t_ns)
        if half_s > 0.0:
            at = impulse[0] + half_s * (before[0] + thrust[0]), impulse[1] + half_s * (before[1] + thrust[1])
            self._reports.append((applied.t_ns, thrust, at))

    def update(self, estimate: Estimate) -> ModelCheck | None:
        """One more estimate that is believed; the word that is due."""
        seen, before = self._look(estimate), self._seen
        if seen is None or (before is not None and seen.t_ns == before.t_ns):
            return None
        self._seen = seen
        if before is None or not 0 < seen.t_ns - before.t_ns <= LONGEST_S * 1e9:
            self._cycles = 0
            return None
        alarm = self.alarm
        self._judge(before, seen)
        due = self._said_ns is None or not 0 <= seen.t_ns - self._said_ns < WORD_NS
        return self._word(seen.t_ns) if due or self.alarm is not alarm else None

    def _look(self, e: Estimate) -> _Seen | None:
        """None where something is missing that it takes."""
        impulse = self._impulse(e.t_ns)
        profile = e.current
        if impulse is None or profile is None:
            return None
        cn, ce = current_at_depth(profile.depth_m, profile.north_mps, profile.east_mps, e.depth_m or 0.0)
        cos, sin = math.cos(e.heading_rad), math.sin(e.heading_rad)
        vn, ve = e.velocity_north_mps - cn, e.velocity_east_mps - ce
        P = e.covariance
        variance = (0.0, 0.0) if P is None else (0.5 * float(P[2, 2] + P[3, 3]), float(P[5, 5]))
        return _Seen(
            e.t_ns,
            cos * vn + sin * ve,
            cos * ve - sin * vn,
            e.yaw_rate_radps,
            e.heading_rad,
            (cn, ce),
            impulse,
            variance,
        )

    def _impulse(self, t_ns: int) -> Pair | None:
        """Of both lateral thrusters up to a time: linear between reports, the last thrust beyond the last."""
        reports = self._reports
        if not reports or t_ns < reports[0][0]:
            return None
        k = len(reports) - 1
        while reports[k][0] > t_ns:
            k -= 1
        at, (f1, f2), (i1, i2) = reports[k]
        s = (t_ns - at) * 1e-9
        if k + 1 < len(reports):
            then, (g1, g2), _ = reports[k + 1]
            half = 0.5 * s * s / ((then - at) * 1e-9)
            return i1 + s * f1 + half * (g1 - f1), i2 + s * f2 + half * (g2 - f2)
        return i1 + s * f1, i2 + s * f2

    def _judge(self, a: _Seen, b: _Seen) -> None:
        p = self._p
        dt = (b.t_ns - a.t_ns) * 1e-9
        half = 0.5 * dt
        i1, i2 = b.impulse[0] - a.impulse[0], b.impulse[1] - a.impulse[1]
        turning = i1 * p.arm_port - i2 * p.arm_starboard
        linear, quadratic = p.linear_surge, p.quadratic_surge
        drag = half * ((linear + quadratic * abs(a.u)) * a.u + (linear + quadratic * abs(b.u)) * b.u)
        linear, quadratic = p.linear_yaw, p.quadratic_yaw
        twist = half * ((linear + quadratic * abs(a.r)) * a.r + (linear + quadratic * abs(b.r)) * b.r)
        coriolis = half * p.mass_sway * (a.v * a.r + b.v * b.r)
        munk = half * (p.mass_surge - p.mass_sway) * (a.u * a.v + b.u * b.v)
        heading = a.heading + 0.5 * math.remainder(b.heading - a.heading, math.tau)
        dn, de = b.current[0] - a.current[0], b.current[1] - a.current[1]
        shear = p.dry_mass * (math.cos(heading) * dn + math.sin(heading) * de)
        z_x = i1 + i2 - drag + coriolis - shear - p.mass_surge * (b.u - a.u)
        z_n = turning - twist + munk - p.inertia_yaw * (b.r - a.r)
        self._residual[0] -= z_x
        self._residual[1] -= z_n
        self._residual[2] += dt
        noise = self._noise
        if self._unsettled_s > 0.0:
            self._unsettled_s -= dt if i1 or i2 else 0.0
            noise += (p.mass_surge * SETTLING_MPS) ** 2
        corrected = max(a.variance[0] - b.variance[0], 0.0) + 2.0 * b.variance[0] * dt / WANDERS_S
        s_x = 1.0 / math.sqrt(noise + p.mass_surge * p.mass_surge * corrected)
        s_n = 1.0 / (p.inertia_yaw * math.sqrt(NOISE_RADPS * NOISE_RADPS + a.variance[1] + b.variance[1]))
        row = (
            (z_x * s_x, z_n * s_n),
            (i1 * s_x, p.arm_port * i1 * s_n),
            (i2 * s_x, -p.arm_starboard * i2 * s_n),
            (drag * s_x, twist * s_n),
            (0.0, 1.0 if b.variance[1] > NOISE_RADPS * NOISE_RADPS else 0.0),
        )
        rows = self._rows
        if self._cycles == len(rows) and not self.alarm:
            learn(self._known, rows[-1])
        self._cycles = min(self._cycles + 1, len(rows))
        rows[1 : self._cycles] = rows[: self._cycles - 1].copy()
        rows[0] = row
        self.evidence, *loss = weigh(rows[: self._cycles], self._known)
        self.loss = loss[0], loss[1]
        self._quiet = 0 if self.evidence >= 0.5 * ALARM else self._quiet + 1
        self.alarm = self.evidence >= ALARM or (self.alarm and self._quiet < QUIET)

    def _word(self, t_ns: int) -> ModelCheck:
        impulse, turn, seconds = self._residual
        self._residual, self._said_ns = [0.0, 0.0, 0.0], t_ns
        return ModelCheck(
            t_ns=t_ns,
            residual_N=impulse / seconds,
            residual_Nm=turn / seconds,
            evidence=self.evidence,
            thrust_loss=self.loss,
            alarm=self.alarm,
            why=self._why() if self.alarm else "",
        )

    def _why(self) -> str:
        port, starboard = (round(100.0 * share) for share in self.loss)
        if not port and not starboard:
            return "the vehicle did less than its thrusters reported, and does as its model says since"
        return f"of the thrust reported, port lacks {port} %, starboard {starboard} %"
