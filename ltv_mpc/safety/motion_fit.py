"""Motion fit: the vehicle, the sea and the stamps that explain the motion of the last minute and a half best.

A steady wind, a wrong vehicle file, an undeclared reference point and estimates that are older than their stamps all
bend the motion, each in another way: a force of the earth stays when the heading turns, drag grows with the speed
through the water, a mass shows in accelerations alone, and a delay shifts all of them. One fit has all of them:

    x (17,)   c   current that the estimates do not contain, north and east (m/s)
              W   steady force of the earth over the mean mass, north and east (m/s^2)
              l   lever arm, and q (8,) model, both as in ``control/disturbance_filter.py``
              d   age of the estimates beyond their stamps (s), not negative
              s   loss of thrust: logarithm of port's share of its thrust if negative, minus that of starboard's if not
              h   what the heading lacks (rad): a compass or its declination

From one estimate to the next the equations of motion (``vehicle/dynamics.py``) with x and the impulses of the delivered
thrust d seconds before give the change of u, v and r. What they lack is added up over segments of ``SEGMENT_S``: e is
the error of each estimated velocity up to a constant. Noise of an estimate then is in one error, and not in the thrust
with which the controller answered it. Gusts, waves and a current that varies add up and are slow, noise of the
estimates is not. So each segment is transformed to cosines of 1 to ``MODES`` half periods, E (3, M), in ``BANDS``, each
with its own noise. x is that of the least

    J = sum over i, bands b of log(|E_ib|^2 / K_b + ``NOISE``^2) K_b / 2 + sum over j of x_j^2 / (2 sd_j^2)

K_b is the number of the cosines in a band. One step of Gauss and Newton each ``EVALUATED`` estimates follows it, and
H^-1 is the covariance if the noise is independent of the motion. What moves the vehicle is not, so names need far more
than noise would (``SIGMAS``).
Source  Ljung 1999, System identification, section 7.4 (concentrated likelihood), section 7.8 (frequency domain).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.control.disturbance_filter import MAX_LOGS, adapted
from ltv_mpc.control.prediction import current_at_depth, profile_of
from ltv_mpc.jit import count_up_to, jit, jit_outlined
from ltv_mpc.messages import Array, Estimate, Pair, Triple
from ltv_mpc.references.limits import path_limits
from ltv_mpc.vehicle.dynamics import coefficients, rates
from ltv_mpc.vehicle.parameters import Vehicle

KEPT_S = 5.0
"""Age up to which thrusts are kept. An estimate that arrives later than this is not compared with the model."""


class ThrustImpulse:
    """Integral of the delivered thrusts of port and starboard over time: linear between two, constant after the last.

    Parameters
    ----------
    kept_s : age (s) up to which thrusts are kept.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self._kept_s, self._origin_ns = kept_s, 0
        self.rows = np.empty((0, 5))
        """Time (s), thrusts of port and starboard (N), and their impulses up to that time (N s)."""

    def seconds(self, t_ns: int) -> float:
        """Return a vehicle time on the time axis of the rows (s).

        Parameters
        ----------
        t_ns : vehicle time (ns).
        """
        return (t_ns - self._origin_ns) * 1e-9

    def add(self, t_ns: int, thrust_N: Triple | Array) -> None:
        """Add the thrusts at a time.

        Parameters
        ----------
        t_ns : vehicle time (ns). What is not newer than the last is ignored.
        thrust_N : of port, starboard and vertical (N).
        """
        rows = self.rows
        if not len(rows):
            self._origin_ns = t_ns
        t, port, starboard = self.seconds(t_ns), float(thrust_N[0]), float(thrust_N[1])
        row = [t, port, starboard, 0.0, 0.0]
        if len(rows):
            t0, port0, starboard0, *impulse = rows[-1].tolist()
            if t <= t0:
                return
            row[3] = impulse[0] + 0.5 * (t - t0) * (port0 + port)
            row[4] = impulse[1] + 0.5 * (t - t0) * (starboard0 + starboard)
            rows = rows[max(int(rows[:, 0].searchsorted(t - self._kept_s, "right")) - 1, 0) :]
        self.rows = np.concatenate([rows, [row]])

    def until(self, t_ns: int) -> Pair | None:
        """Return the impulses (N s) up to ``t_ns``; None before the oldest thrusts that are kept.

        Parameters
        ----------
        t_ns : time (ns).
        """
        t = self.seconds(t_ns)
        return impulses(self.rows, t) if len(self.rows) and t >= self.rows[0, 0] else None


@jit
def impulses(rows: Array, t: float) -> Pair:
    """Return the impulses (N s) of port and starboard up to a time.

    Parameters
    ----------
    rows : as in ``ThrustImpulse``, at least one.
    t : time (s), not before the first row.
    """
    k = count_up_to(rows[:, 0], t) - 1
    at, later = rows[k], rows[min(k + 1, len(rows) - 1)]
    s = t - at[0]
    half = 0.5 * s * s / (later[0] - at[0]) if later[0] > at[0] else 0.0
    return at[3] + s * at[1] + half * (later[1] - at[1]), at[4] + s * at[2] + half * (later[2] - at[2])


T, VELOCITY, HEADING, YAW_RATE, PROFILE, SEGMENT = 0, slice(1, 3), 3, 4, slice(5, 7), 7
"""Columns of the motion."""


class Record(NamedTuple):
    """Record of estimates and thrusts, by time."""

    motion: Array  # (K, 8) time (s), velocity over ground, heading, yaw rate, the profile's current, segment
    thrust: Array  # (R, 5) time (s), of port and starboard (N), and their impulses (N s)


class Segments(NamedTuple):
    """Cosines of the segments of a motion, and their bands."""

    cosines: Array  # (K, M), by their half periods
    begins: npt.NDArray[np.int64]  # (B,) first cosine of each band
    worth: Array  # (B,) number of the cosines in each band

    @classmethod
    def of(cls, segments: Array) -> Segments:
        """Return the cosines of segments.

        Parameters
        ----------
        segments : (K,) segment of each row.
        """
        K = len(segments)
        each, begins, sizes = np.unique(segments, return_index=True, return_counts=True)
        m, n = np.arange(1, MODES + 1)[:, None], sizes.repeat(sizes)
        angle = np.pi * (np.arange(K) - begins.repeat(sizes) + 0.5) / n
        cosines = np.sqrt(2.0 / n) * np.cos(m * angle) * (m < n)
        modes = (cosines[:, None] * (each[:, None] == segments)).reshape(-1, K).T  # (K, M), by m
        begins = np.array(BANDS) * len(each)
        worth = np.maximum(np.add.reduceat((m < sizes).sum(axis=1), BANDS), 1)
        return cls(modes, begins, worth)

    def noise(self, E: Array, floor: Array) -> Array:
        """Return the variances (3, B) of errors in each band.

        Parameters
        ----------
        E : (3, M) errors.
        floor : (3,) least variances.
        """
        return np.add.reduceat(E**2, self.begins, axis=1) / self.worth + floor[:, None]

    def unlikely(self, E: Array, floor: Array) -> float:
        """Return 2 J of errors, without the prior (nats).

        Parameters
        ----------
        E, floor : as in ``noise``.
        """
        return float((np.log(self.noise(E, floor)) @ self.worth).sum())


SIZE, ARM, MODEL, DELAY, LOSS, TURN = 17, 4, 6, 14, 15, 16
"""Number of unknowns, and the first of each kind."""

MEMORY_S, SEGMENT_S, MIN_SEGMENTS = 90.0, 5.0, 4
"""Time that is fitted, length of a segment, and the number of segments from which seventeen unknowns are known."""

MAX_INTERVAL_S = 1.05
"""Longest interval: beyond it the velocities in between are not linear."""

EVALUATED, TESTED = 10, (2, 5, 8)
"""Estimates from one step to the next; and those between them at which another record may be compared."""

NOISE = 2e-3
"""Least error of a velocity over the top speed, and of a yaw rate over half of what a second of full thrust gives."""

MAX_DELAY_S, DELAY_STEP_S, STEP = 1.5, 0.05, 1e-4
"""Largest delay; and steps of the finite differences: of the delay (s), and of the others over their scales."""

MODES, BANDS = 7, (0, 1, 3)
"""Half periods in a segment that are fitted, from 1 on, and the places where bands begin: 1, 2 to 3, 4 to 7."""

SIGMAS = np.array([10.0] * ARM + [6.5] * 2 + [10.0, 10.0, 13.0] + [10.0] * (TURN - MODEL - 3) + [14.0])
"""Unknowns over their standard deviations from which they are certain (docs/notes/wrong-file.md). Right files reach 11
with the inertia, which velocities that are wrong for some seconds change by the Munk moment, 11 with the heading, of
estimates at 1 Hz with noise, and 9 with the others; an arm is not named below 0.25 m.
"""

BOUND_SIGMAS = np.where(SIGMAS < 10.0, 2.0, 3.0)
"""Standard deviations by which an unknown may be less than it seems: noise that the controller answers shifts it."""

PREDICTED_AFTER_NS = 1_000_000_000
"""Age of the last report from which the thrust is that of the sent commands through the lag."""

SD = np.array([0.5] * 2 + [0.3] * 4 + [0.5] * 6 + [0.3, 0.3, 0.5, 0.3, 0.3])
"""Prior standard deviations: c over the top speed, W over what full thrust gives, l in m, logarithms, added Munk mass
over the mean mass, steady moment over that of full thrust, d in s, s, h in rad.
"""


class MotionFit:
    """Fit of vehicle, sea and stamps to the motion of one source of estimates."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Begin with the vehicle file, still water and right stamps.

        Parameters
        ----------
        vehicle : from its file.
        """
        self._file, lateral = np.array(vehicle.coefficients()), vehicle.thrusters[:2]
        top_mps, mean_kg = path_limits(vehicle).top_mps, 0.5 * float(self._file[:2].sum())
        full_mps2 = sum(t.max_N for t in lateral) / mean_kg
        turning_radps2 = sum(t.max_N * t.arm_m for t in lateral) / vehicle.yaw.inertia_kgm2
        self._scale = np.array([*[top_mps] * 2, *[full_mps2] * 2, *[1.0] * 9, turning_radps2, *[1.0] * 3])
        self.floor = (NOISE * np.array((top_mps, top_mps, 0.5 * turning_radps2))) ** 2
        """Least variances of the errors."""
        most = np.full(SIZE, np.inf)
        most[:2], most[MODEL : MODEL + 6], most[DELAY] = top_mps, MAX_LOGS[:6], MAX_DELAY_S
        self._bounds = np.where(np.arange(SIZE) == DELAY, 0.0, -most), most
        self._motion = np.empty((0, 8))
        self.segments: Segments | None = None
        """Segments of the last step."""
        self._impulse, self.reported_ns = ThrustImpulse(MEMORY_S + MAX_DELAY_S), 0
        self._begin_s, self._new = 0.0, 0  # of the newest segment; estimates since the last step
        self.x = np.zeros(SIZE)
        """Most likely unknowns."""
        self.certain = np.zeros(SIZE)
        """What they are at least, with their signs; 0 where they may be none."""
        # compiled before it is needed
        current_at_depth(np.zeros(1), np.zeros(1), np.zeros(1), 0.0)
        _fill_misfit(self.x, self._file, np.zeros((1, 8)), np.zeros((1, 5)), np.empty((3, 1)))

    def add_thrust(self, t_ns: int, thrust_N: Triple | Array, *, reported: bool = True) -> None:
        """Add the delivered thrusts at a time.

        Parameters
        ----------
        t_ns : vehicle time (ns). Thrusts that are not newer than the last are ignored.
        thrust_N : of port, starboard and vertical (N).
        reported : by the actuators; False: predicted, which is used if there are no newer reports.
        """
        if reported:
            self.reported_ns = t_ns
        elif t_ns - self.reported_ns < PREDICTED_AFTER_NS:
            return
        self._impulse.add(t_ns, thrust_N)

    def update(self, estimate: Estimate) -> bool:
        """Add an estimate. Return True if another record may be compared now: in a cycle without a step.

        Parameters
        ----------
        estimate : as it was given; nothing of it is filtered.
        """
        t, motion, thrust = self._impulse.seconds(estimate.t_ns), self._motion, self._impulse.rows
        segment, passed_s = (motion[-1, 7], t - motion[-1, 0]) if len(motion) else (0.0, np.inf)
        if passed_s < 0.0:  # the clock was set back
            self._motion, self._impulse = motion[:0], ThrustImpulse(MEMORY_S + MAX_DELAY_S)
        if passed_s <= 0.0 or not len(thrust) or t < thrust[0, 0] + MAX_DELAY_S:
            return False
        if passed_s > MAX_INTERVAL_S or t >= self._begin_s + SEGMENT_S:
            self._begin_s, segment = t, segment + 1.0
        water = current_at_depth(*profile_of(estimate.current), estimate.depth_m or 0.0)
        over_ground = estimate.velocity_north_mps, estimate.velocity_east_mps
        row = t, *over_ground, estimate.heading_rad, estimate.yaw_rate_radps, *water, segment
        self._motion = np.concatenate([motion, [row]])
        self._new += 1
        if self._new >= EVALUATED:
            self._new, self._motion = 0, self._motion[self._motion[:, 0] > t - MEMORY_S]
            if self._motion[-1, 7] - self._motion[0, 7] >= MIN_SEGMENTS:
                self.segments = Segments.of(self._motion[:, SEGMENT])
                self._step(self.segments)
        return self._new in TESTED and self.segments is not None

    @property
    def of_observer(self) -> Array:
        """Most likely states (12,) of the disturbance observer."""
        return np.concatenate([self.x[:2], self.x[ARM:DELAY]])

    @property
    def record(self) -> Record:
        """Record that the last step explains, not copied."""
        K = len(self._motion) if self.segments is None else len(self.segments.cosines)
        return Record(self._motion[:K], self._impulse.rows)

    def misfit(self, x: Array, record: Record, segments: Segments) -> Array:
        """Return the errors E (3, M) of the velocities.

        Parameters
        ----------
        x : (17,) unknowns.
        record, segments : what they explain.
        """
        e = np.empty((3, len(record.motion)))
        _fill_misfit(x, self._file, *record, e)
        E: Array = e @ segments.cosines
        return E

    def unlikely(self, x: Array, record: Record, segments: Segments) -> float:
        """Return 2 J (nats).

        Parameters
        ----------
        x : (17,) unknowns.
        record, segments : what they explain.
        """
        prior = float(((x / (SD * self._scale)) ** 2).sum())
        return segments.unlikely(self.misfit(x, record, segments), self.floor) + prior

    def improved(self, x: Array, record: Record, segments: Segments) -> tuple[Array, Array]:
        """Take one step of Gauss and Newton, as far as J falls.

        Parameters
        ----------
        x : (17,) unknowns.
        record, segments : what they explain.

        Returns
        -------
        (17,) unknowns after the step, and (17, 17) H before it.
        """
        steps, prior = STEP * self._scale, (SD * self._scale) ** -2.0
        steps[DELAY] = DELAY_STEP_S
        E = self.misfit(x, record, segments)
        moved = [self.misfit(x + step, record, segments) for step in np.diag(steps)]
        slopes = (np.stack(moved, axis=1) - E[:, None]) / steps[:, None]
        widths = np.diff(segments.begins, append=E.shape[1])
        weighted = slopes / segments.noise(E, self.floor).repeat(widths, axis=1)[:, None]
        H = (weighted @ slopes.mT).sum(axis=0) + np.diag(prior)
        step = np.linalg.solve(H, -np.einsum("ijk,ik->j", weighted, E) - prior * x)

        tried = (np.clip(x + share * step, *self._bounds) for share in (1.0, 0.4, 0.16, 0.0))
        return min(tried, key=lambda x: self.unlikely(x, record, segments)), H

    def _step(self, segments: Segments) -> None:
        """Take one step, and set what is certain."""
        x = self.x
        self.x, H = self.improved(x, self.record, segments)
        if self.x[DELAY] == 0.0:  # at its bound it is no unknown
            H[DELAY, DELAY] = 1e12
        sd = np.sqrt(np.diag(np.linalg.inv(H)))
        if (np.abs(self.x - x) > sd).any():  # far from the least J: the next step is sooner
            self._new = EVALUATED // 2
        size = np.abs(self.x)
        self.certain = np.where(size > SIGMAS * sd, np.copysign(size - BOUND_SIGMAS * sd, self.x), 0.0)


@jit_outlined
def _fill_misfit(x: Array, file: Array, motion: Array, thrust: Array, out: Array) -> None:
    """Write the errors (3, K) of u, v and r, by the rows of the motion (K, 8) and of ``ThrustImpulse`` (R, 5)."""
    p = coefficients(adapted(file, x[MODEL:DELAY]))
    over_dry = -0.5 * (file[0] + file[1]) / p.dry_mass  # a force of the earth acts like water that accelerates
    port_share, starboard_share = np.exp(min(x[LOSS], 0.0)), np.exp(min(-x[LOSS], 0.0))
    u0 = v0 = r0 = du0 = dv0 = dr0 = port0 = starboard0 = 0.0
    for k in range(len(motion)):
        t, psi, r = motion[k, 0], motion[k, 3] + x[TURN], motion[k, 4]
        cos, sin = np.cos(psi), np.sin(psi)
        north, east = motion[k, 1] - motion[k, 5] - x[0], motion[k, 2] - motion[k, 6] - x[1]
        u, v = cos * north + sin * east + r * x[ARM + 1], cos * east - sin * north - r * x[ARM]
        _, _, du, dv, _, dr = rates(u, v, psi, r, 0.0, 0.0, 0.0, 0.0, x[2] * over_dry, x[3] * over_dry, p)
        port, starboard = impulses(thrust, t - x[DELAY])
        if k == 0 or motion[k, 7] != motion[k - 1, 7]:
            out[0, k] = out[1, k] = out[2, k] = 0.0
        else:
            h, dn, de = 0.5 * (t - motion[k - 1, 0]), motion[k, 5] - motion[k - 1, 5], motion[k, 6] - motion[k - 1, 6]
            f1, f2 = port_share * (port - port0), starboard_share * (starboard - starboard0)
            # The change of the profile with time and depth carries the vehicle: M [u', v'] = ... - m R(psi)' c'
            surge, sway = f1 + f2 - p.dry_mass * (cos * dn + sin * de), -p.dry_mass * (cos * de - sin * dn)
            out[0, k] = out[0, k - 1] + u - u0 - h * (du + du0) - surge / p.mass_surge
            out[1, k] = out[1, k - 1] + v - v0 - h * (dv + dv0) - sway / p.mass_sway
            yaw = f1 * p.arm_port - f2 * p.arm_starboard
            out[2, k] = out[2, k - 1] + r - r0 - h * (dr + dr0) - yaw / p.inertia_yaw
        u0, v0, r0, du0, dv0, dr0, port0, starboard0 = u, v, r, du, dv, dr, port, starboard
