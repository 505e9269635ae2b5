"""Model monitor: compare the motion between two estimates with what the model predicts from the reported thrusts.

Impulses over dt from one estimate to the next, for the thrusts F that the actuators report (port a1, starboard a2):

    I_i = integral of F_i                                                                       N s
    X   = I_1 + I_2       - d_x(u) dt   + M_y v r dt - m [ cos psi, sin psi] . dc               surge
    N   = a1 I_1 - a2 I_2 - d_psi(r) dt + M_m u v dt                                            yaw
    z_x = X - M_x du,   z_n = N - I_z dr                                                        missing impulse

with d_x(u) = (d_x + D_x |u|) u and d_psi(r) likewise, and the coefficients that the controller has learned. Its steady
moment is left out: a lost thrust is one. If the thrusters deliver (1 - l_i) of the reported thrust, and the drag is
(1 + b) times that of the model, in units of the true mass:

    z_x = l_1 I_1    + l_2 I_2    + b d_x dt   + e_x,    e_x ~ N(0, M_x^2 (q^2 + s^2))
    z_n = a1 l_1 I_1 - a2 l_2 I_2 + b d_psi dt + e_n,    e_n ~ N(0, I_z^2 (p^2 + P_r0 + P_r1))

q and p are the noise of the change of velocity and yaw rate, and s^2 is the variance of the error of the estimated
change of velocity (``velocity_change_variance``). The noise P_r of the yaw rate is new in each estimate and enters two
successive e_n with opposite signs. So the sum of e_n over a window contains only the noise of its first and its last
estimate (``thrust_loss_detector.whitened``).

The alarm is raised at ``ALARM_NATS`` of evidence that l has grown, beyond what 10 % of mismatch and the behaviour so
far explain (``thrust_loss_detector.py``). While the alarm is on, the behaviour so far is not updated.

The monitor needs reports of the actuators. It cannot distinguish a loss of thrust from a change of the current that the
estimate does not contain, or from a tow; the model is wrong in these cases too.

Estimates without a current: u and v are relative to the current that the controller has learned (``disturbance.py``).
That current follows any force that lasts, so it can explain a missing surge impulse, and its corrections look like
forces. So only the yaw row counts. With s_c the standard deviation of the learned current, its error gives a moment
that lasts for tau_m = ``UNMODELLED_TIME_S``:

    m_c = |M_x - M_y| (|u| + |v|) s_c                             e_n has the additional variance 2 tau_m dt m_c^2

Vehicles that are not ``identified``: the model is a data sheet, wrong by more than 10 %. At low speed drag alone can
look like half of the thrust, so the surge row does not count. A current in the estimates has the standard deviation
s_c = ``GIVEN_CURRENT_SD_MPS``. Fins and hull give moments that the model does not contain. These are two more unknowns,
learned like the mismatch,

    z_n = ... + g_1 (M_x + M_y) u v dt + g_2 (M_x + M_y) a |u| r dt,     a = (a1 + a2) / 2

and what they do not explain adds to m_c. The yaw rows are then not whitened.

    m = m_c + ``OF_THRUST`` (a1 |F1| + a2 |F2|) + ``OF_MOTION`` [|d_psi(r)| + (M_x + M_y) |u| (|v| + a |r|)]
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.control.disturbance import Belief, velocity_change_variance, velocity_variance
from ltv_mpc.control.prediction import current_at_depth, profile_of
from ltv_mpc.messages import Applied, Array, Estimate, ModelCheck, Pair
from ltv_mpc.safety.motion_fit import ThrustImpulse
from ltv_mpc.safety.thrust_loss_detector import Row, ThrustLossDetector
from ltv_mpc.safety.weak_thruster import WeakThruster, attribute
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle

ALARM_NATS = 12.0
"""Evidence that raises the alarm. With e^-12 for each evaluation and 700 of them in a run of 200 s, this is one false
alarm in 200 runs with the largest mismatch.
"""

NOISE_MPS = 1e-3
"""q, noise of the change of velocity between two estimates."""

QUIET_CYCLES = 10
"""Successive cycles with evidence below half of ``ALARM_NATS`` after which the alarm ends. A loss that is still in a
window can keep the evidence above this.
"""

NOISE_RADPS = 2e-4
"""p: noise of the change of yaw rate from the gyro bias and the trapezoidal integrals."""

OF_THRUST, OF_MOTION, UNMODELLED_TIME_S = 0.01, 0.02, 1.5
"""Unmodelled yaw moment of a vehicle that is not identified: shares of the known moments, and its time constant. With
these the healthy foreign craft of tests/foreign_plant, whose model is wrong in fins and Munk moment, gives 3 nats.
"""

GIVEN_CURRENT_SD_MPS = 0.01
"""s_c of a current in the estimates, if the vehicle is not identified. With 0 that craft gives 8 nats."""

MAX_INTERVAL_S = 1.0
"""Largest time between two estimates for which the trapezoidal integrals are accurate enough."""

PUBLICATION_PERIOD_NS = 1_000_000_000


class _Motion(NamedTuple):
    """Motion of one estimate, and the impulses of all reports up to its time."""

    t_ns: int
    velocity: Pair  # over ground, north and east
    r: float
    heading: float
    current: Pair
    impulse: Pair
    variance: Pair  # of a velocity component, of the yaw rate
    learned_sd: float | None  # of the current (m/s); None if the estimate contains the current

    @property
    def through_water(self) -> Pair:
        """Surge and sway velocity through the water (m/s)."""
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        vn, ve = self.velocity[0] - self.current[0], self.velocity[1] - self.current[1]
        return cos * vn + sin * ve, cos * ve - sin * vn


class ModelMonitor:
    """Detector of lost thrust from the motion of one vehicle."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Begin without a report and an estimate.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        self._p = vehicle.coefficients()
        # M_x^2 q^2; None: the vehicle is not identified, so the surge row does not count
        self._noise = (self._p.mass_surge * NOISE_MPS) ** 2 if vehicle.identified else None
        self._impulse = ThrustImpulse()
        self._last: _Motion | None = None
        self._detector = ThrustLossDetector()
        # Time of the last publication (ns), and since then missing impulse (N s), turn (N m s), and time (s).
        self._missing: tuple[int | None, Array] = None, np.zeros(3)
        self._quiet_cycles = 0
        self.weak_thruster = WeakThruster()
        """Thruster that lost thrust, if it is one."""
        self.evidence = 0.0
        """Log-likelihood ratio of a thrust loss (nats)."""
        self.alarm = False
        """The vehicle does not move as its model predicts."""
        self.loss: Pair = (0.0, 0.0)
        """Most likely lost share of the thrust: port, starboard."""

    @property
    def suspects_loss(self) -> bool:
        """True while a loss of thrust has half of the evidence that raises the alarm, and during the alarm."""
        return self.alarm or self.evidence >= 0.5 * ALARM_NATS

    @property
    def products(self) -> Array | None:
        """Behaviour of the vehicle so far, (6, 6) (``thrust_loss_detector.py``), a copy; None if unknown."""
        return self._detector.products

    def restore(self, products: Array) -> None:
        """Continue from the ``products`` (6, 6) of another monitor of this vehicle.

        Parameters
        ----------
        products : (6, 6) products of the other monitor.
        """
        self._detector.restore(products)

    def restart(self) -> None:
        """Begin with another source of estimates: its motion is not compared with that of the last one."""
        self._last, self._missing, self._quiet_cycles = None, (None, np.zeros(3)), 0
        self._detector.clear_window()

    def dismiss(self) -> None:
        """Withdraw alarm and weak thruster, and what the motion has shown so far: it was not that of its stamps."""
        self._detector, self.alarm = ThrustLossDetector(), False
        self.weak_thruster.restore((1.0, 1.0))

    def add_report(self, applied: Applied) -> None:
        """Add a report of the actuators.

        Parameters
        ----------
        applied : the report.
        """
        self._impulse.add(applied.t_ns, applied.thrust_N)

    def update(
        self, estimate: Estimate, learned: Belief | None = None, model: Array | None = None
    ) -> ModelCheck | None:
        """Add an accepted estimate. Return the message to publish: at each change of the alarm, and every second.

        Parameters
        ----------
        estimate : newest accepted estimate.
        learned : current that the controller has learned, for an estimate without one; None: there is none either.
        model : (21,) coefficients that the controller has learned; None: those of the vehicle file. What is wrong from
            the start is no loss.
        """
        if model is not None:
            self._p = Coefficients(*model.tolist())
        motion, before = self._motion(estimate, learned), self._last
        if motion is None or (before is not None and motion.t_ns == before.t_ns):
            return None
        self._last = motion
        if (
            before is None
            or not 0 < motion.t_ns - before.t_ns <= MAX_INTERVAL_S * 1e9
            or (before.learned_sd is None) is not (motion.learned_sd is None)
        ):
            self._detector.clear_window()
            return None
        alarm = self.alarm
        self._evaluate(before, motion)
        since_ns = self._missing[0]
        due = since_ns is None or not 0 <= motion.t_ns - since_ns < PUBLICATION_PERIOD_NS  # also if time went back
        return self._message(motion.t_ns) if due or self.alarm is not alarm else None

    def _motion(self, e: Estimate, learned: Belief | None) -> _Motion | None:
        """Return the motion of an estimate; None without reports up to its time or without any current."""
        impulse = self._impulse.until(e.t_ns)
        learned_sd = None
        if impulse is None:
            return None
        if e.current is not None:
            cn, ce = current_at_depth(*profile_of(e.current), e.depth_m or 0.0)
        elif learned is not None:
            cn, ce = learned[0].tolist()
            learned_sd = math.sqrt(0.5 * float(np.trace(learned[1])))
        else:
            return None
        P = e.covariance
        variance = velocity_variance(e), 0.0 if P is None else float(P[5, 5])
        return _Motion(
            e.t_ns,
            (e.velocity_north_mps, e.velocity_east_mps),
            e.yaw_rate_radps,
            e.heading_rad,
            (cn, ce),
            impulse,
            variance,
            learned_sd,
        )

    def _evaluate(self, a: _Motion, b: _Motion) -> None:
        """Add the missing impulses from ``a`` to ``b`` to the detector, and update the alarm and the weak thruster."""
        if b.learned_sd is not None:
            a = a._replace(current=b.current)  # a correction of the learned current is not a motion
        row = self._row(a, b)
        self.evidence, *loss = self._detector.add(row, learn=not self.alarm)
        self.loss = loss[0], loss[1]
        self._quiet_cycles = 0 if self.evidence >= 0.5 * ALARM_NATS else self._quiet_cycles + 1
        self.alarm = self.evidence >= ALARM_NATS or (self.alarm and self._quiet_cycles < QUIET_CYCLES)
        weak = self.weak_thruster
        gain = self._detector.recovery_gain(weak.loss) if weak.is_weak else 0.0
        if weak.update(b.t_ns, attribute(self.loss) if self.alarm else None, gain):
            self._detector.clear_window()  # the loss is over
        self.alarm |= weak.is_weak

    def _row(self, a: _Motion, b: _Motion) -> Row:
        """Return the row of the detector for the motion from ``a`` to ``b``."""
        p = self._p
        dt = (b.t_ns - a.t_ns) * 1e-9
        half = 0.5 * dt
        (au, av), (bu, bv) = a.through_water, b.through_water
        i1, i2 = b.impulse[0] - a.impulse[0], b.impulse[1] - a.impulse[1]
        linear, quadratic = p.linear_surge, p.quadratic_surge
        drag = half * ((linear + quadratic * abs(au)) * au + (linear + quadratic * abs(bu)) * bu)
        linear, quadratic = p.linear_yaw, p.quadratic_yaw
        twist = half * ((linear + quadratic * abs(a.r)) * a.r + (linear + quadratic * abs(b.r)) * b.r)
        coriolis = half * p.mass_sway * (av * a.r + bv * b.r)
        munk = half * (p.mass_surge - p.mass_sway + p.added_munk) * (au * av + bu * bv)
        heading = a.heading + 0.5 * math.remainder(b.heading - a.heading, math.tau)
        dn, de = b.current[0] - a.current[0], b.current[1] - a.current[1]
        shear = p.dry_mass * (math.cos(heading) * dn + math.sin(heading) * de)
        z_x = i1 + i2 - drag + coriolis - shear - p.mass_surge * (bu - au)
        z_n = i1 * p.arm_port - i2 * p.arm_starboard - twist + munk - p.inertia_yaw * (b.r - a.r)
        self._missing[1][:] += z_x, z_n, dt
        s_x = fresh = cross = lift = 0.0
        current_sd = b.learned_sd or 0.0
        unmodelled = 0.0
        if self._noise is not None:
            if b.learned_sd is None:
                of_estimates = p.mass_surge**2 * velocity_change_variance(a.variance[0], b.variance[0], dt)
                s_x = 1.0 / math.sqrt(self._noise + of_estimates)
            fresh = 1.0 if b.variance[1] > NOISE_RADPS * NOISE_RADPS else 0.0
        else:
            current_sd = GIVEN_CURRENT_SD_MPS if b.learned_sd is None else b.learned_sd
            mass, arm = p.mass_surge + p.mass_sway, 0.5 * (p.arm_port + p.arm_starboard)
            cross = half * mass * (au * av + bu * bv)
            lift = half * mass * arm * (abs(au) * a.r + abs(bu) * b.r)
            of_thrust = p.arm_port * abs(i1) + p.arm_starboard * abs(i2)
            of_motion = abs(twist) + mass * abs(bu) * (abs(bv) + arm * abs(b.r)) * dt
            unmodelled = OF_THRUST * of_thrust + OF_MOTION * of_motion
        unmodelled += abs(p.mass_surge - p.mass_sway) * (abs(bu) + abs(bv)) * current_sd * dt
        yaw_noise = p.inertia_yaw**2 * (NOISE_RADPS**2 + a.variance[1] + b.variance[1])
        yaw_noise += 2.0 * UNMODELLED_TIME_S / dt * unmodelled * unmodelled
        s_n = 1.0 / math.sqrt(yaw_noise)
        return (
            (z_x * s_x, z_n * s_n),
            (i1 * s_x, p.arm_port * i1 * s_n),
            (i2 * s_x, -p.arm_starboard * i2 * s_n),
            (drag * s_x, twist * s_n),
            (0.0, cross * s_n),
            (0.0, lift * s_n),
            (0.0, fresh),
        )

    def _message(self, t_ns: int) -> ModelCheck:
        force, moment, seconds = self._missing[1].tolist()
        self._missing = t_ns, np.zeros(3)
        return ModelCheck(
            t_ns=t_ns,
            residual_N=-force / seconds,
            residual_Nm=-moment / seconds,
            evidence=self.evidence,
            thrust_loss=self.loss,
            alarm=self.alarm,
            why=self._reason() if self.alarm else "",
        )

    def _reason(self) -> str:
        port, starboard = (round(100.0 * share) for share in self.loss)
        if not port and not starboard:
            return "the vehicle moved less than its reported thrusts explain; since then it moves as its model predicts"
        return f"lost share of the reported thrust: port {port} %, starboard {starboard} %"
