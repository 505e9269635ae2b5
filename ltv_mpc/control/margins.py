"""Margins of the closed loop: the gain, dead time and lag that it bears although the controller does not know of them.

The controller applies the first stage of a plan and then plans again: a feedback that need not be stable, because the
optimal plan of a finite horizon can postpone what has to be done within it. The loop is linearised about a steady state
with no limit active: station keeping with the bow into a current. Relative to the water and to a target that moves with
it, cruise at that speed is the same motion, with the same loop; with the stern ahead the poles are the same.

Over stages k = 1 .. N of length g_k the controller minimises, with state X and commands U (flow.py), the last commands
U, a constant error c of the current, and z = [X; U; c] (12,):

    z+ = A_k z + B_k U+,    A_k = [[A, B0, h I], [0, 0, 0], [0, 0, I]],    B_k = [B1; I; 0]            linearisation.py
    J  = sum g_k (w |p|^2 + r |U+ / F|^2) + s / g_k |(U+ - U) / F|^2 + w_N |p_N|^2 + m |p'_N|^2           ocp/terms

The Riccati recursion from the last stage to the first ends with U+ = - K z. The state of the loop, once a cycle at the
time of the estimate, is [X; F; b; U_k, U_(k-1), ..]: the plant's state, the thrusts that the controller takes for
delivered, its estimate of the current, and the commands that are under way.

    plant       X+ through the commands, g times as strong, later by the dead time and slower by the lag
    prediction  of z over the known delay, from the measured motion, b and F                          prediction.py
    feedback    U_(k+1) = - K z
    observer    b+ = b + L (v - v_predicted), L the steady Kalman gain without noise of the estimates     disturbance.py

The loop keeps a change of the plant if its spectral radius is at most 1. Only the controllable part of the plant
counts: at rest in the water no thrust moves it aside to first order, and with M_x = M_y and no linear drag to the side
v + U psi is constant, so a drift is not controllable at any speed. These are repeated poles at 1 that no feedback
moves, and rounding makes them grow: they are left out (``_controllable``). What the vehicle does there is of second
order, and flights are the evidence. Unobservable is the heading at rest: a simple pole at 1, which does not grow.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.disturbance import DEFAULT_SD_MPS, NOISE_SHARE
from ltv_mpc.control.disturbance_filter import SURGE_ERROR
from ltv_mpc.control.linearisation import linearise, velocity_over_ground
from ltv_mpc.control.problem_data import STAGE_S
from ltv_mpc.control.scaling import characteristic_scales, state_scale, thrust_scale
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle

POLE_TOLERANCE = 1e-6
"""Rounding error that a pole at 1 may have."""

GAIN_UP_DB, GAIN_DOWN_DB, DEAD_TIME_S, LAG_S = 6.0, 3.0, 0.3, 0.3
"""Margins that the default weights keep in currents up to ``FULL_SHARE``."""

FULL_SHARE, SHARES = 0.4, tuple(i / 20 for i in range(17))
"""Currents over the top speed: the strongest in which all margins are asked for, and those that are examined. Above it
a dead time of ``DEAD_TIME_S`` or 0.3 / p is, with p the fastest unstable pole of the hull.
"""

LARGEST_DB, LARGEST_S = 20.0, 2.0
"""Margins beyond these are not sought."""

UNCONTROLLABLE = 1e-9
"""Size of a direction, in the scales of the QP, up to which it is rounding."""

COMMANDS, CURRENT = slice(STATES, STATES + 2), slice(STATES + 2, STATES + 4)  # of z


class Change(NamedTuple):
    """Change of the plant that the controller does not know of."""

    gain_db: float = 0.0  # of both thrusters
    dead_time_s: float = 0.0
    lag_s: float = 0.0  # in addition to the vehicle's


class Margins(msgspec.Struct, frozen=True, kw_only=True):
    """Largest changes that the loop keeps in one current, each alone; 20 dB and 2 s: at least that, 0: none."""

    current_mps: float
    gain_up_db: float
    gain_down_db: float
    dead_time_s: float
    lag_s: float
    unstable_per_s: float  # fastest unstable pole of the hull; 0: none
    aside_controllable: bool  # False: no thrust moves it aside to first order


class Loop:
    """Linear closed loop in one current."""

    @np.errstate(over="ignore", invalid="ignore")
    def __init__(self, vehicle: Vehicle, config: ResolvedConfig, share: float) -> None:
        """Compute the feedback and the observer's gain.

        Parameters
        ----------
        vehicle : vehicle to be controlled.
        config : weights, horizon, delay and observer of the controller.
        share : current over the vehicle's top speed.
        """
        self._p, self._config = vehicle.coefficients(), config
        self._share, self._speed = share, share * characteristic_scales(vehicle).speed_mps
        thrust = thrust_scale(vehicle)
        self._scale = np.array([*state_scale(vehicle), *thrust])
        self._velocity = np.pad(velocity_over_ground(*steady_state(self._p, self._speed))[1], ((0, 0), (2, 3)))
        self._delay_s = max(config.first_delay_s, config.min_delay_s)
        A = _stage(self._p, self._speed, STAGE_S)[0]
        growth = math.log(_radius(A[2:6, 2:6])) / STAGE_S  # the pole of the heading makes it at least 0
        self._unstable = growth if growth > POLE_TOLERANCE / STAGE_S else 0.0
        try:
            self._K = self._feedback(thrust)
        except np.linalg.LinAlgError:  # drag that is faster than a step makes A overflow
            self._K = np.full((2, CURRENT.stop), np.nan)
        self.observer_gain = self._observer_gain(A, NOISE_SHARE * characteristic_scales(vehicle).speed_mps)
        """L (2, 2), north and east."""

    @np.errstate(over="ignore", invalid="ignore")
    def radius(self, change: Change = Change()) -> float:  # noqa: B008
        """Return the magnitude of the largest pole, per cycle.

        Parameters
        ----------
        change : of the plant.

        Returns
        -------
        Spectral radius; infinite if the stages are too long for the vehicle's motion to be integrated.
        """
        return _radius(self._closed(change))

    def keeps(self, changes: Iterable[Change] = (Change(),)) -> bool:
        """Return True if no pole grows with any of the changes.

        Parameters
        ----------
        changes : of the plant.
        """
        return all(self.radius(change) <= 1.0 + POLE_TOLERANCE for change in changes)

    @property
    def goal(self) -> list[Change]:
        """Changes that the default weights have to keep in this current, each whole and half."""
        full = self._share <= FULL_SHARE
        dead_time_s = DEAD_TIME_S if full or not self._unstable else min(DEAD_TIME_S, 0.3 / self._unstable)
        whole = [Change(dead_time_s=dead_time_s)]
        if full:
            whole += [Change(gain_db=GAIN_UP_DB), Change(gain_db=-GAIN_DOWN_DB), Change(lag_s=LAG_S)]
        return [Change(), *whole, *(Change(*(0.5 * amount for amount in change)) for change in whole)]

    def margins(self) -> Margins:
        """Return the largest changes that the loop keeps."""
        aside = self._controllable(self._p)[1]  # row of e
        return Margins(
            current_mps=self._speed,
            gain_up_db=self._largest("gain_db", LARGEST_DB),
            gain_down_db=self._largest("gain_db", -LARGEST_DB),
            dead_time_s=self._largest("dead_time_s", LARGEST_S),
            lag_s=self._largest("lag_s", LARGEST_S),
            unstable_per_s=self._unstable,
            aside_controllable=float(np.abs(aside).max()) > 0.1,  # it is 0 up to rounding, or not small
        )

    def _largest(self, field: str, end: float) -> float:
        """Return the change of one field, towards ``end``, up to which all are kept, within 1 / 10,000 of ``end``."""
        kept, step = 0.0, 1.0 / 40.0
        while step > 1e-4:
            while kept < 1.0 and self.keeps([Change()._replace(**{field: min(kept + step, 1.0) * end})]):
                kept = min(kept + step, 1.0)
            step /= 4.0
        return kept * abs(end) if self.keeps() else 0.0

    def _feedback(self, thrust_N: Array) -> Array:
        """Return K (2, 12)."""
        weights, size = self._config.weights, CURRENT.stop
        thrust, change = np.diag(weights.thrust / thrust_N**2), np.diag(weights.thrust_change / thrust_N**2)
        position, commands = np.diag([1.0, 1.0, *np.zeros(size - 2)]), np.eye(size)[COMMANDS]
        over_ground = np.hstack([self._velocity, np.zeros((2, 2)), np.eye(2)])
        P = weights.terminal_position_per_m2 * position
        P = P + weights.terminal_velocity_s2_per_m2 * over_ground.T @ over_ground
        K = np.empty(0)
        for g in np.diff(self._config.knots)[::-1].round(9).tolist():
            A, B = np.eye(size), np.zeros((size, 2))
            A[:STATES, :STATES], A[:STATES, COMMANDS], B[:STATES] = _stage(self._p, self._speed, g * STAGE_S)
            A[COMMANDS, COMMANDS], A[:2, CURRENT], B[COMMANDS] = 0.0, g * STAGE_S * np.eye(2), np.eye(2)
            P = P + g * weights.position_per_m2 * position
            S = change / g
            both = B.T @ P @ A - S @ commands
            K = np.linalg.solve(g * thrust + S + B.T @ P @ B, both)
            P = A.T @ P @ A + commands.T @ S @ commands - both.T @ K
            P = 0.5 * (P + P.T)
        return K

    def _observer_gain(self, A: Array, noise_mps: float) -> Array:
        """Return L (2, 2): each component of the velocity is used alone, with the gain of a scalar random walk."""
        settings, X = self._config.disturbance, steady_state(self._p, self._speed)[0]
        sd_mps = DEFAULT_SD_MPS if settings.sd_mps is None else settings.sd_mps
        # Change of the velocity over ground by an error of the current: what drag does to it, H = 1 - ..
        H = 1.0 - np.diag(self._velocity @ A[:, 2:4])
        Q = settings.walk_mps_per_rts**2 * STAGE_S
        model = SURGE_ERROR * 2.0 * (X[6] + X[7]) * STAGE_S / self._p.mass_surge  # thrust and drag, as much each
        R = (settings.noise_mps or noise_mps) ** 2 + np.array([model, 0.0]) ** 2
        # P = P - P^2 H^2 / (H^2 P + R) + Q, at most the prior; without drag P is the prior
        P = np.minimum(0.5 * (Q + np.sqrt(Q * Q + 4.0 * Q * R / np.maximum(H * H, 1e-12))), sd_mps**2)
        return np.diag(P * H / (H * H * P + R))

    def _closed(self, change: Change) -> Array:
        """Return the matrix of the loop from one estimate to the next, of its controllable part."""
        p = self._p
        slow = p._replace(lag_port=p.lag_port + change.lag_s, lag_starboard=p.lag_starboard + change.lag_s)
        total_s = self._delay_s + change.dead_time_s
        history = math.floor(total_s / STAGE_S + 1e-9) + 2  # commands U_k, U_(k-1), .. that still act
        size = CURRENT.stop + 2 * history
        rows = np.eye(size + 2)
        # U_(k+1), which is the input, and then U_k, U_(k-1), ..
        U = [rows[size:], *(rows[i : i + 2] for i in range(CURRENT.stop, size, 2))]
        known = np.vstack([rows[:6], rows[COMMANDS]])  # the motion as the controller knows it
        bias = rows[CURRENT]
        known[2:4] -= bias
        plan_start = self._through(known, U, p, self._delay_s, self._delay_s)
        new = -self._K @ np.vstack([plan_start, U[1], bias])
        plant = self._through(rows[:STATES], U, slow, total_s, STAGE_S, 10.0 ** (change.gain_db / 20.0))
        predicted = self._through(known, U, p, self._delay_s, STAGE_S)
        learned = bias + self.observer_gain @ (self._velocity @ (plant - predicted) - bias)
        after = np.vstack([plant, predicted[6:STATES], learned, *U[:-1]])
        closed: Array = after[:, :size] + after[:, size:] @ new[:, :size]
        Q = self._controllable(slow)  # X = scale Q x
        left, right = closed[:STATES], self._scale[:, None] * Q
        closed = np.vstack([Q.T @ (left / self._scale[:, None]), closed[STATES:]])
        return np.hstack([closed[:, :STATES] @ right, closed[:, STATES:]])

    def _through(
        self, X: Array, U: list[Array], p: Coefficients, delay_s: float, duration_s: float, gain: float = 1.0
    ) -> Array:
        """Return the state (8, M) after a time from an estimate on, in which each command acts a delay after it.

        X (8, M) and U (2, M), the newest first, are linear in the state of the loop. U[1] is in force at the estimate's
        time plus ``delay_s``.
        """
        j = math.floor(delay_s / STAGE_S + 1e-9) + 1
        knot_s, t_s = delay_s - (j - 1) * STAGE_S, 0.0  # U[j] is in force at knot_s
        here = U[j] + (U[j + 1] - U[j]) * knot_s / STAGE_S
        while t_s < duration_s - 1e-9:
            end_s = min(knot_s, duration_s)
            if end_s - t_s > 1e-9:
                there = U[j] + (U[j + 1] - U[j]) * (knot_s - end_s) / STAGE_S
                A, B0, B1 = _stage(p, self._speed, round(end_s - t_s, 9))
                X, here, t_s = A @ X + gain * (B0 @ here + B1 @ there), there, end_s
            j, knot_s = j - 1, knot_s + STAGE_S
        return X

    def _controllable(self, p: Coefficients) -> Array:
        """Return an orthonormal basis (8, n) of the controllable states, in the scales of the QP.

        Staircase: what the thrusts move, and then what the motion makes of that, while it adds a direction.
        """
        A, B0, B1 = _stage(p, self._speed, STAGE_S)
        if not np.isfinite(A).all():
            return np.eye(STATES)
        A = A * self._scale / self._scale[:, None]
        new = np.hstack([B0, B1]) * self._scale[6] / self._scale[:, None]
        Q = np.zeros((STATES, 0))
        while new.shape[1] and Q.shape[1] < STATES:
            for _ in range(2):  # once is not enough for directions that are almost in Q
                new = new - Q @ (Q.T @ new)
            directions, size, _ = np.linalg.svd(new, full_matrices=False)
            new = directions[:, size > UNCONTROLLABLE]
            Q, new = np.hstack([Q, new]), A @ new
        return Q


def steady_state(p: Coefficients, speed_mps: float) -> tuple[Array, Array]:
    """Return the steady state of station keeping, heading north into a current to the south.

    Parameters
    ----------
    p : coefficients of the vehicle.
    speed_mps : of the current (m/s).

    Returns
    -------
    State X (8,) and current C (2,), north and east (m/s).
    """
    push = (p.linear_surge + p.quadratic_surge * speed_mps) * speed_mps
    port, starboard = p.arm_starboard, p.arm_port  # no moment
    X = np.array([0.0, 0.0, speed_mps, 0.0, 0.0, 0.0, port, starboard])
    X[6:] *= push / (port + starboard)
    return X, np.array([-speed_mps, 0.0])


@lru_cache(maxsize=1024)
def _stage(p: Coefficients, speed_mps: float, h: float) -> tuple[Array, Array, Array]:
    """Return A (8, 8), B0 (8, 2) and B1 (8, 2) of a stage of h seconds."""
    X, C = steady_state(p, speed_mps)
    lin = linearise(np.tile(X, (2, 1)), np.tile(X[6:], (2, 1)), np.tile(C, (2, 1)), h, p)
    return lin.A[0], lin.B0[0], lin.B1[0]


def _radius(matrix: Array) -> float:
    """Return the spectral radius; infinite if a number is not finite."""
    try:
        return float(np.abs(np.linalg.eigvals(matrix)).max())
    except np.linalg.LinAlgError:
        return math.inf
