"""LQR about the trim in which the vehicle stands over ground: head into the water that it meets, thrust equal to drag.

    trim    u* = |c|, v* = r* = 0, psi* = direction of -c (or stern first, where that is nearer), F* = drag(u*) / 2 each
    x       = [along, across, u - u*, v, psi - psi*, r]      in the trim's axes
    F       = F* - K(u*) x,   K from the discrete algebraic Riccati equation of the model's own Jacobian at the trim

It is told the true current at its own depth. Exactly at the trim the sway cannot be steered: with M_x = M_y a turn
leaves the velocity over ground as it is, and the quadratic drag that would change it has no slope at v = 0. So the sway
is given the drag's slope at ``sway_mps``, and K is that of a water speed of at least ``least_mps``. An error beyond
``most_m`` counts as that much, or the linearisation would turn the vehicle round.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.linalg import expm, solve_discrete_are

from benchmarks.rivals.pid import PERIOD_S, nearer_axis
from ltv_mpc.control.prediction import currents_at_depths
from ltv_mpc.frames import wrap_angle
from ltv_mpc.messages import Array, Estimate, Pair
from ltv_mpc.vehicle import dynamics
from ltv_mpc.vehicle.parameters import Vehicle

SPEEDS = 40
"""Gains are computed at so many speeds of the water, and taken linearly between them."""


class Lqr:
    """LQR with its weights by name. Raises ``LinAlgError`` for weights without a gain.

    thrust (|F / max|^2 against metres squared), velocity (of u, v), heading, yaw_rate; sway_mps, least_mps, most_m.
    """

    def __init__(self, vehicle: Vehicle, weights: dict[str, float]) -> None:
        self._p = vehicle.coefficients()
        self._most_m, self._sway_mps = weights["most_m"], weights["sway_mps"]
        self._most_N = np.array([t.max_N for t in vehicle.thrusters[:2]])
        Q = np.diag([1.0, 1.0, *2 * [weights["velocity"]], weights["heading"], weights["yaw_rate"]])
        R = weights["thrust"] * np.eye(2)  # of F / max
        self._speeds = np.geomspace(weights["least_mps"], 1.0, SPEEDS)
        self._gains = {
            sign: make_interp_spline(self._speeds, [self._gain(sign * speed, Q, R) for speed in self._speeds], k=1)
            for sign in (1.0, -1.0)
        }

    def thrust(self, estimate: Estimate, target_m: Pair) -> Pair:
        """See above."""
        assert estimate.current is not None
        assert estimate.depth_m is not None
        c = currents_at_depths(estimate.current, np.array([estimate.depth_m]))[0]
        psi, speed = estimate.heading_rad, math.hypot(*c)
        into = math.atan2(-c[1], -c[0])
        trim = nearer_axis(into, psi)
        sign = 1.0 if math.cos(trim - into) > 0 else -1.0
        off = np.array([estimate.north_m - target_m[0], estimate.east_m - target_m[1]])
        off *= min(1.0, self._most_m / max(math.hypot(*off), 1e-12))
        through = np.array([estimate.velocity_north_mps, estimate.velocity_east_mps]) - c
        u, v = turned(through, psi)
        x = np.array([*turned(off, trim), u - sign * speed, v, wrap_angle(psi - trim), estimate.yaw_rate_radps])
        drag = sign * (self._p.linear_surge + self._p.quadratic_surge * speed) * speed
        gain = self._gains[sign](np.clip(speed, self._speeds[0], self._speeds[-1]))
        port, starboard = 0.5 * drag - gain @ x
        return float(port), float(starboard)

    def _gain(self, u: float, Q: Array, R: Array) -> Array:
        """Return the gain (2, 6) at the trim speed u (m/s), in axes along the trim's heading."""
        trim, step = np.array([0.0, 0.0, u, 0.0, 0.0, 0.0, 0.0, 0.0]), 1e-6
        ahead, behind = (
            np.array([dynamics.rates(*at[2:], 0.0, 0.0, 0.0, 0.0, self._p) for at in trim + side * step * np.eye(8)])
            for side in (1.0, -1.0)
        )
        A, B = np.split((ahead - behind).T / (2.0 * step), [6], axis=1)
        A[3, 3] = -(self._p.linear_sway + 2.0 * self._p.quadratic_sway * self._sway_mps) / self._p.mass_sway
        B *= self._most_N
        h = PERIOD_S
        held = expm(h * np.block([[A, B], [np.zeros((2, 8))]]))  # the thrust is held for a period
        F, G = held[:6, :6], held[:6, 6:]
        S = solve_discrete_are(F, G, h * Q, h * R)
        gain: Array = self._most_N[:, None] * np.linalg.solve(h * R + G.T @ S @ G, G.T @ S @ F)
        return gain


def turned(vector: Array, psi: float) -> tuple[float, float]:
    """North, east as along and across a heading."""
    cos, sin = math.cos(psi), math.sin(psi)
    return float(cos * vector[0] + sin * vector[1]), float(cos * vector[1] - sin * vector[0])
