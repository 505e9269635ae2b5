"""Multiple shooting: least-squares fit of a vehicle's coefficients to a recorded motion.

The run is cut into segments of some seconds. From an unknown initial state y_s = [u, v, r] each segment follows the
exact flow of the model under the recorded commands, and is compared with the estimates y_k of u, v (through the water)
and r:

    min over theta, c, y_s of   sum_k | (y_k - R_k' c - flow_k(y_s, theta)) / sd |^2
                                + sum_i ((theta_i - 1) / PRIOR)^2 + | c / CURRENT_SD_MPS |^2

theta_i is a coefficient divided by its value in the file (or by a suitable size if the file has 0). So the second term
is a prior of 100 % of the file's value, which dominates where the run is not informative. The y_s are eliminated
segment by segment (variable projection: Golub & Pereyra 1973).

c = [c_n, c_e] is a nuisance parameter: the current that the estimates do not contain. It is constant over the run and
enters y as R_k' c, with the heading of instant k in R_k. Without it a current would be taken for damping and inertia.

Two more coefficients are the reference point l = [forward, starboard] (m) relative to the declared one, of which the
estimates give the velocity: u - r_k l_2 and v + r_k l_1 are compared with y_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Times
from ltv_mpc.vehicle.flow import STATES, advance_stage, lag_table, lag_weights
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from ltv_mpc.vehicle.resistance import UNBRAKED_MPS, UNBRAKED_RADPS, steady_speed

SEGMENT_S = 6.0
"""Length of a segment."""
MAX_GAP_S = 1.0
"""Largest time between two estimates of one segment."""

PRIOR = 1.0
"""Standard deviation of the prior of theta."""

CURRENT_SD_MPS = 0.5
"""Standard deviation of the prior of each component of the current that the estimates do not contain (m/s)."""

STEP = 1e-4
"""Step of the finite differences: relative for a coefficient, in m/s and rad/s for an initial state."""

MIN_THETA = 0.05
"""Smallest theta of an inertia or the thrust scale."""

MAX_RESIDUAL = 1e4
"""Residual (m/s, rad/s) from which a predicted motion counts as diverged."""

MAX_GROWTH = 1e4
"""Growth of a change of the initial state within a segment, from which a predicted motion counts as diverged."""

MAX_VALUE = {"arm": 100.0, "lag": 60.0, "reference": 100.0}
"""Largest size of a coefficient that a vehicle file accepts, by the first word of its name; of the others ``1e7``."""

LAGS = ("lag_port", "lag_starboard")
REFERENCE_POINT = ("reference_forward", "reference_starboard")
"""Offsets of the reference point from the declared one (m), of any sign; they are 0 in the file's own terms."""


class Motion(NamedTuple):
    """Recorded motion and commands of a vehicle at M instants."""

    t_s: Array  # (M,) increasing
    velocity: Array  # (M, 3) u, v less the known current (m/s, FRD), yaw rate r (rad/s)
    heading: Array  # (M,) rad
    shear: Array  # (M, 2) rate of the current along the path, dc/dz w, north and east (m/s2)
    command: Array  # (M, 2) commanded thrust of port and starboard (N), linear in between
    sd: Array  # (3,) standard deviations of the errors of velocity
    thrust: Array | None = None  # (M, 2) delivered thrust by the reports of the actuators (N); None without reports


class _Series(NamedTuple):
    """Motion in the types of the compiled code; ``input`` is the delivered thrust if reported, else the command."""

    t: Array
    velocity: Array
    heading: Array
    shear: Array
    input: Array


class ShootingFit:
    """Least-squares problem of one motion for some of the coefficients and the unknown current.

    Parameters
    ----------
    vehicle : vehicle with the values of the file.
    motion : recorded motion.
    free : names of the coefficients to fit; ``thrust`` is the factor on the commands. The vector ``theta`` (P,) has
        them in this order, then the current north and east in units of ``CURRENT_SD_MPS``.
    """

    def __init__(self, vehicle: Vehicle, motion: Motion, free: Sequence[str]) -> None:
        self.free = tuple(free)
        """Names of the fitted coefficients."""
        self.nominal = np.array([*vehicle.coefficients(), 1.0, 0.0, 0.0])
        """Coefficients of the file, 1 for the thrust scale, and 0 for the reference point (22,)."""
        self.scale = theta_scale(vehicle)
        """Coefficients at theta = 1 (24,)."""
        input_ = motion.command if motion.thrust is None else motion.thrust
        if motion.thrust is not None:  # the reported thrust already contains the lag
            self.nominal[[index_of(name) for name in LAGS]] = 0.0
        self._series = _Series(motion.t_s, motion.velocity, motion.heading, motion.shear, input_)
        self.edges = segments(motion.t_s)
        """First instant and end of each segment (S, 2)."""
        self._counts = self.edges[:, 1] - self.edges[:, 0]
        self.sd = motion.sd.copy()
        """Standard deviations (3,) of the errors of u, v and r."""
        self._indices = [index_of(name) for name in self.free]
        self._measured = motion.velocity[self.edges[:, 0]]
        compared = np.concatenate([np.arange(first, end) for first, end in [(0, 0), *self.edges.tolist()]])
        self._to_body = _rotations(motion.heading[compared])
        self._yaw_rate = motion.velocity[compared, 2]

    @property
    def origin(self) -> Array:
        """Theta of the file (P,): 1, or 0 for a coefficient that is 0 there, and for the current."""
        return np.append(self.nominal[self._indices] / self.scale[self._indices], [0.0, 0.0])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bound of theta (P,): physical, and within what a vehicle file accepts.

        A total mass is at least the dry mass; damping, arms and lags are not negative.
        """
        lower, upper = [], []
        for name, scale in zip(self.free, self.scale[self._indices].tolist(), strict=True):
            kind = name.partition("_")[0]
            upper.append(MAX_VALUE.get(kind, 1e7) / scale)
            if kind == "mass":
                lower.append(float(self.nominal[_DRY_MASS]) / scale)
            else:
                lower.append({"reference": -upper[-1], "inertia": MIN_THETA, "thrust": MIN_THETA}.get(kind, 0.0))
        return np.array([*lower, -np.inf, -np.inf]), np.array([*upper, np.inf, np.inf])

    def residuals(self, theta: Array) -> Array:
        """Return the residuals (3 M' + P,) of the motion from the best initial states, and of the prior.

        They are infinite if the predicted motion diverges.

        Parameters
        ----------
        theta : (P,) coefficients and current.
        """
        r, _ = self._reduced(theta, slopes=False)
        return np.concatenate([r.ravel(), (theta - self.origin) / PRIOR])

    def jacobian(self, theta: Array) -> Array:
        """Return d residuals / d theta (3 M' + P, P).

        Parameters
        ----------
        theta : (P,) coefficients and current.
        """
        _, J = self._reduced(theta, slopes=True)
        return np.concatenate([J.reshape(-1, len(theta)), np.eye(len(theta)) / PRIOR])

    def by_segment(self, theta: Array) -> tuple[list[Array], list[Array]]:
        """Return residuals (3 m,) and slopes (3 m, P) of each segment, initial states eliminated.

        Parameters
        ----------
        theta : (P,) coefficients and current.
        """
        r, J = self._reduced(theta, slopes=True)
        ends = np.cumsum(self._counts)[:-1]
        return [part.ravel() for part in np.split(r, ends)], [
            part.reshape(-1, len(theta)) for part in np.split(J, ends)
        ]

    @np.errstate(over="ignore", invalid="ignore")
    def response(self, theta: Array, forces: Sequence[Array]) -> Array:
        """Return the changes (M', 3, K) of the whitened residuals by small additional forces.

        The part that changes of the initial states explain is taken out.

        Parameters
        ----------
        theta : (P,) coefficients and current.
        forces : K arrays (M, 3) of forces ahead and to starboard (N) and moment (N m), which are linear in between.
        """
        refined = self._refined(theta)
        assert refined is not None  # theta is a solution
        series, changes, (start, base, Jy) = self._series, [], refined
        port, starboard = self.nominal[[index_of("arm_port"), index_of("arm_starboard")]]
        sin, cos = np.sin(series.heading), np.cos(series.heading)
        for force in forces:
            # ahead and moment by the thrusters; to starboard by the water, whose acceleration acts on the dry mass
            F1 = (force[:, 0] * starboard + force[:, 2]) / (port + starboard)
            across = -force[:, 1] / self.nominal[_DRY_MASS]
            input_ = series.input + STEP * np.column_stack([F1, force[:, 0] - F1])
            shear = series.shear + STEP * np.column_stack([-sin * across, cos * across])
            self._series = series._replace(input=input_, shear=shear)
            try:
                changes.append((self._shoot(theta, start) - base) / STEP)
            finally:
                self._series = series
        E = self._finite_columns(np.stack(changes, axis=-1))
        return E - self._explained(Jy, E)

    @np.errstate(over="ignore", invalid="ignore")  # of a motion that diverges
    def _reduced(self, theta: Array, *, slopes: bool) -> tuple[Array, Array]:
        """Return whitened residuals (M', 3) and slopes (M', 3, P), without the part explained by the initial states.

        Residuals of a motion that diverges are infinite.
        """
        refined = self._refined(theta)
        if refined is None:
            return np.full((len(self._to_body), 3), np.inf), np.zeros((len(self._to_body), 3, len(theta)))
        start, base, Jy = refined
        r = base - self._explained(Jy, base[..., None])[..., 0]
        if not slopes:
            return r, np.empty((*r.shape, 0))
        J = np.empty((*r.shape, len(theta)))
        for i in range(len(theta)):
            ahead = theta.copy()
            ahead[i] += STEP
            J[..., i] = (self._shoot(ahead, start) - base) / STEP
        J = self._finite_columns(J)
        return r, J - self._explained(Jy, J)

    def _refined(self, theta: Array) -> tuple[Array, Array, Array] | None:
        """Return the best initial states (S, 3), the residuals (M', 3) and their slopes; None if the motion diverges.

        They begin at the measured ones, less current and reference point of theta: those of a trial step far away may
        lead to a local minimum.
        """
        first = np.cumsum(self._counts) - self._counts
        refined, start = None, self._measured - self.sd * self._shoot(theta, self._measured)[first]
        for _ in range(3):  # the problem is nearly linear in its initial states
            r = self._shoot(theta, start)
            Jy = np.stack([(self._shoot(theta, start + step) - r) / STEP for step in STEP * np.eye(3)], axis=-1)
            if not (np.all(np.abs(r * self.sd) < MAX_RESIDUAL) and np.all(np.abs(Jy * self.sd[:, None]) < MAX_GROWTH)):
                break
            refined = start, r, Jy
            start = start - self._best_change(Jy, r[..., None])[:, :, 0]
        return refined

    def _finite_columns(self, J: Array) -> Array:
        """Return slopes (M', 3, K) with zero in place of each column that is not finite: it shows nothing."""
        return np.where(np.all(np.abs(STEP * J * self.sd[:, None]) < MAX_RESIDUAL, axis=(0, 1)), J, 0.0)

    def _best_change(self, Jy: Array, vectors: Array) -> Array:
        """Return the changes (S, 3, K) of the initial states that fit ``vectors`` (M', 3, K) best."""
        # normal equations of each segment; they are regular because its first instant is its initial state itself
        first = np.cumsum(self._counts) - self._counts
        left = np.add.reduceat(np.einsum("mcx,mcy->mxy", Jy, Jy), first)
        return np.linalg.solve(left, np.add.reduceat(np.einsum("mcy,mck->myk", Jy, vectors), first))

    def _explained(self, Jy: Array, vectors: Array) -> Array:
        """Return the part of ``vectors`` (M', 3, K) that changes of the initial states explain."""
        change: Array = np.repeat(self._best_change(Jy, vectors), self._counts, axis=0)
        part: Array = np.einsum("mcy,myk->mck", Jy, change)
        return part

    def _shoot(self, theta: Array, start: Array) -> Array:
        """Return whitened residuals (M', 3) of all segments from their initial states (S, 3)."""
        values = self.nominal.copy()
        values[self._indices] = theta[:-2] * self.scale[self._indices]
        # the acceleration of the water acts on the dry mass, which is assumed proportional to the total surge mass
        values[_DRY_MASS] = self.nominal[_DRY_MASS] * values[0] / self.nominal[0]
        off = np.empty((int(self._counts.sum()), 3))
        *coefficients, thrust, forward, starboard = values
        _shoot(Coefficients(*coefficients), thrust, self._series, self.edges, start, off)
        off[:, :2] += self._to_body @ (CURRENT_SD_MPS * theta[-2:])
        off[:, :2] += np.outer(self._yaw_rate, (-starboard, forward))
        return off / self.sd


def _rotations(heading: Array) -> Array:
    """Return R(psi)' (M, 2, 2) from north and east to ahead and starboard."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.stack([np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)], axis=-2)


def through_the_water(motion: Motion, current_mps: Array) -> Array:
    """Return u, v (m/s) and r (rad/s) of a motion (M, 3), less a current that its estimates do not contain.

    Parameters
    ----------
    motion : recorded motion.
    current_mps : (2,) current, north and east (m/s).
    """
    velocity = motion.velocity.copy()
    velocity[:, :2] -= _rotations(motion.heading) @ current_mps
    return velocity


_DRY_MASS = Coefficients._fields.index("dry_mass")


@jit
def lagged_thrust(t: Array, command: Array, start: float, lag: float) -> Array:
    """Return the delivered thrust (M,) in N.

    Parameters
    ----------
    t : (M,) times (s).
    command : (M,) commanded thrust (N), linear in between.
    start : thrust at the first time (N).
    lag : time constant of the thruster (s).
    """
    F = np.empty(len(t))
    F[0] = start
    for k in range(len(t) - 1):
        a, b0, b1 = lag_weights(t[k + 1] - t[k], t[k + 1] - t[k], lag)
        F[k + 1] = a * F[k] + b0 * command[k] + b1 * command[k + 1]
    return F


@jit
def _shoot(p: Coefficients, scale: float, series: _Series, edges: Times, start: Array, off: Array) -> None:
    """Write model minus estimate (M', 3), segment after segment, into ``off``.

    ``scale`` multiplies the input; ``edges`` (S, 2) are first instant and end of each segment.
    """
    t, velocity, heading, shear, command = series
    F = np.empty(command.shape)
    for i in range(2):
        lag = p.lag_port if i == 0 else p.lag_starboard
        F[:, i] = lagged_thrust(t, scale * command[:, i], scale * command[0, i], lag)
    X, out = np.zeros(STATES), np.empty(STATES)
    c0, c1 = np.zeros(2), np.zeros(2)
    row = 0
    for s in range(len(edges)):
        X[2], X[3], X[5] = start[s, 0], start[s, 1], start[s, 2]
        for k in range(edges[s, 0], edges[s, 1]):
            off[row, 0], off[row, 1], off[row, 2] = X[2] - velocity[k, 0], X[3] - velocity[k, 1], X[5] - velocity[k, 2]
            row += 1
            if k + 1 < edges[s, 1]:
                h = t[k + 1] - t[k]
                X[4], X[6], X[7] = heading[k], F[k, 0], F[k, 1]
                c1[0], c1[1] = h * shear[k, 0], h * shear[k, 1]
                advance_stage(X, scale * command[k], scale * command[k + 1], c0, c1, h, p, lag_table(h, p), out)
                X[:] = out


def segments(t_s: Array) -> Times:
    """Return first instant and end (S, 2) of segments of ``SEGMENT_S`` between gaps, none shorter than half of that."""
    breaks = np.flatnonzero(np.diff(t_s) > MAX_GAP_S) + 1
    edges: list[tuple[int, int]] = []
    for first, end in zip([0, *breaks], [*breaks, len(t_s)], strict=True):
        at = int(first)
        while at < end:
            to = min(int(np.searchsorted(t_s, t_s[at] + SEGMENT_S, side="right")), int(end))
            if t_s[to - 1] - t_s[at] >= 0.5 * SEGMENT_S:
                edges.append((at, to))
            at = to
    return np.array(edges, dtype=np.int64).reshape(-1, 2)


def index_of(name: str) -> int:
    """Return the index of a coefficient in ``Coefficients``; then come the thrust scale and the reference point."""
    return (*Coefficients._fields, "thrust", *REFERENCE_POINT).index(name)


def theta_scale(vehicle: Vehicle) -> Array:
    """Return the coefficients at theta = 1 (24,): those of the file, or for a 0 one of equal effect at full thrust.

    Those of the reference point are 1 m.
    """
    p = vehicle.coefficients()
    port, starboard = vehicle.thrusters[:2]
    push = vehicle.pushes_N[0]
    couple = port.max_N * p.arm_port + starboard.max_N * p.arm_starboard
    speed = min(steady_speed(push, p.linear_surge, p.quadratic_surge), UNBRAKED_MPS)
    rate = min(steady_speed(couple, p.linear_yaw, p.quadratic_yaw), UNBRAKED_RADPS)
    of_equal_effect = {
        "linear_surge": p.quadratic_surge * speed or push / speed,
        "quadratic_surge": p.linear_surge / speed or push / speed**2,
        "linear_sway": p.quadratic_sway * speed or push / speed,
        "quadratic_sway": p.linear_sway / speed or push / speed**2,
        "linear_yaw": p.quadratic_yaw * rate or couple / rate,
        "quadratic_yaw": p.linear_yaw / rate or couple / rate**2,
        "lag_port": 0.2,
        "lag_starboard": 0.2,
        "arm_port": p.arm_starboard,
        "arm_starboard": p.arm_port,
    }
    values = np.array([*p, 1.0, 1.0, 1.0])
    for name, value in of_equal_effect.items():
        if values[index_of(name)] == 0.0:
            values[index_of(name)] = max(value, 1e-6)
    return values
