"""Rigid body in water with six degrees of freedom, for all hulls of this folder.

    [l, h] = M nu                                                momentum in still water, body frame
    l' = f - w x l,   h' = m - w x h - v x l                     Kirchhoff (Fossen 2021, eq 6.43)
    p' = R(q) v + c,  q' = q o [0, w] / 2

nu = [v, w] (6,) velocity relative to the water and turning rate, both forward, starboard, down; M (6, 6) rigid body and
added mass about the geometric centre CO; q the attitude; c a current that is the same everywhere. v x l contains the
Munk moment. f and m (N, N m) are the sum of

    linear drag        - D nu                                    D (6, 6) need not be diagonal
    quadratic drag     - q_i |nu_i| nu_i
    strips             - k |v_k| v_k across the hull at a place x or y of it, v_k the local velocity: cross-flow drag of
                       the length (sway and yaw, heave and pitch), or the drag of each of two hulls (surge and yaw)
    fins               - L |u| (v + x r) at x, and the same for heave
    munk               cancelled u v in yaw (kg), for published models that leave the Munk moment out
    restoring          - G [heave, roll, pitch]                  G (3, 3)
    two thrusters      thrust k n |n| - lost |n| u at +-arm; n follows the driver's n_c with a lag, or the thrust does

It imports only the compiler of this project, none of its equations. All of it is in one file: numba notices an edit of
a function's own file, so the compiled code cannot be older than its source. Integrator: Runge-Kutta of order 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Pair

SURGE, SWAY, HEAVE, ROLL, PITCH, YAW = range(6)


def _zeros(*shape: int) -> Array:
    return np.zeros(shape)


@dataclass(frozen=True, kw_only=True)
class Hull:
    """Parameters of one hull, about its geometric centre; see the module."""

    name: str
    M: Array  # (6, 6) kg, kg m, kg m2
    D: Array  # (6, 6) kg/s, kg m/s, N m s
    centre_of_gravity: tuple[float, float, float]  # m, forward, starboard, down of the geometric centre
    max_N: float  # largest thrust of one thruster at rest
    min_N: float
    arms_m: Pair  # of port and starboard, from the centre line
    lag_s: float
    quadratic: Array = field(default_factory=lambda: _zeros(6))  # kg/m, kg m2
    across: Array = field(default_factory=lambda: _zeros(0, 2))  # (K, 2) x (m), k (kg/m): strips along the length
    along: Array = field(default_factory=lambda: _zeros(0, 2))  # (K, 2) y (m), k (kg/m): drag of each hull
    vertical_share: float = 1.0  # k of a strip in heave over that in sway
    fin_kgpm: float = 0.0
    fin_m: float = 0.0  # place of the fins, negative: astern
    cancelled_munk_kg: float = 0.0
    G: Array = field(default_factory=lambda: _zeros(3, 3))  # N/m, N m
    lost: float = 0.0  # thrust lost to speed, share of the bollard pull of full thrust a m/s
    lag_of_revolutions: bool = True  # False: the thrust itself follows the command with the lag

    def packed(self) -> Array:
        """Return all numbers in one flat array, as ``advance`` reads them."""
        scalars = [
            *self.quadratic, *self.G.ravel(), *self.arms_m, self.lag_s, self.min_N, self.max_N, self.lost,
            float(self.lag_of_revolutions), self.vertical_share, self.fin_kgpm, self.fin_m, self.cancelled_munk_kg,
        ]  # fmt: skip
        return np.array(scalars)

    def drag_N(self, speed_mps: float) -> float:
        """Return the drag of steady straight motion ahead."""
        quadratic = self.quadratic[SURGE] + self.along[:, 1].sum()
        return float((self.D[SURGE, SURGE] + quadratic * abs(speed_mps)) * speed_mps)

    def top_speed_mps(self) -> float:
        """Return the steady speed ahead at full thrust."""
        return float(brentq(lambda u: 2.0 * self.max_N * max(0.0, 1.0 - self.lost * u) - self.drag_N(u), 0.0, 20.0))


class Plant:
    """Hull that is simulated: its position, attitude, velocity and thrusters.

    ``hull.centre_of_gravity`` is the point whose position the attributes and ``run`` give.
    """

    def __init__(
        self,
        hull: Hull,
        *,
        position_m: Pair = (0.0, 0.0),
        heading_rad: float = 0.0,
        current_mps: Pair = (0.0, 0.0),
        force_N: Pair = (0.0, 0.0),
        shares: Pair = (1.0, 1.0),
    ) -> None:
        """Put the hull on the surface, at rest over ground.

        Parameters
        ----------
        hull : its parameters.
        position_m : of its centre of gravity, north and east.
        heading_rad : clockwise from north.
        current_mps : velocity of the water, north and east.
        force_N : steady force of the wind on the geometric centre, north and east.
        shares : of the thrust of port and starboard that reaches the water.
        """
        self.hull = hull
        self.force_N = force_N
        c, s = math.cos(heading_rad), math.sin(heading_rad)
        x, y, _ = hull.centre_of_gravity
        self.state = np.zeros(16)
        """Position of the geometric centre (3), quaternion (4), nu (6), revolutions or thrust (2), heading."""
        self.state[0], self.state[1] = position_m[0] - c * x + s * y, position_m[1] - s * x - c * y
        self.state[3], self.state[6] = math.cos(heading_rad / 2), math.sin(heading_rad / 2)
        self.state[7] = -c * current_mps[0] - s * current_mps[1]
        self.state[8] = s * current_mps[0] - c * current_mps[1]
        self._numbers = hull.packed()
        self._inverse = np.linalg.inv(hull.M)
        self._gravity = np.array(hull.centre_of_gravity)
        self.outside = np.array([*current_mps, *force_N, *shares])
        """Current, wind and shares, which may be set in place as the state."""
        self._shape = tuple(np.ascontiguousarray(a, dtype=float) for a in (hull.M, self._inverse, hull.D))
        self._strips = np.ascontiguousarray(hull.across, dtype=float), np.ascontiguousarray(hull.along, dtype=float)
        self.state[15] = heading_rad

    def run(self, commands_N: Array, dt_s: float) -> Array:
        """Advance by one step for each pair of commands.

        Parameters
        ----------
        commands_N : (M, 2) thrust commanded to port and starboard, each constant over a step.
        dt_s : length of a step.

        Returns
        -------
        (M, 8) after each step: north, east (m), heading (rad, unwrapped), velocity north, east (m/s over ground), yaw
        rate (rad/s) and the delivered thrust of port and starboard (N).
        """
        track = np.empty((len(commands_N), 8))
        advance(
            self.state, self._numbers, *self._shape, *self._strips, self.outside, self._gravity,
            np.ascontiguousarray(commands_N, dtype=float), dt_s, track,
        )  # fmt: skip
        return track

    def set_outside(self, current_mps: Pair, force_N: Pair) -> None:
        """Change water and wind; the velocity relative to the water stays, as the water carries the hull along."""
        self.outside[:4] = *current_mps, *force_N

    def step(self, command_N: Pair, dt_s: float) -> Array:
        """Advance by one step; return the row (8,) of ``run``."""
        row: Array = self.run(np.array([command_N]), dt_s)[0]
        return row

    @property
    def velocity(self) -> Array:
        """Velocity (6,) relative to the water at the geometric centre, which may be set in place."""
        return self.state[7:13]

    @property
    def heading_rad(self) -> float:
        """Heading, clockwise from north, unwrapped."""
        return float(self.state[15])

    @property
    def actuators(self) -> Array:
        """Revolutions over those of full thrust, or thrust (N), of port and starboard, which may be set in place."""
        return self.state[13:15]

    @property
    def attitude_rad(self) -> Pair:
        """Roll and pitch."""
        _, _, _, w, x, y, z = self.state[:7]
        return math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)), math.asin(2 * (w * y - x * z))


@jit
def advance(
    x: Array,
    numbers: Array,
    M: Array,
    inverse: Array,
    D: Array,
    across: Array,
    along: Array,
    outside: Array,
    gravity: Array,
    commands: Array,
    h: float,
    track: Array,
) -> None:
    """Integrate the state ``x`` (16,) in place, one step for each row of commands, and fill ``track`` (M, 8)."""
    lag, low, high, lost = numbers[17], numbers[18], numbers[19], numbers[20]
    by_revolutions = numbers[21] > 0.5
    half = math.exp(-0.5 * h / lag) if lag > 0.0 else 0.0
    k1, k2, k3, k4, y = np.empty(13), np.empty(13), np.empty(13), np.empty(13), np.empty(13)
    wanted, thrust = np.empty(2), np.empty((3, 2))
    for row in range(commands.shape[0]):
        for i in range(2):
            command = min(max(commands[row, i], low), high)
            if by_revolutions:  # revolutions over those of full thrust ahead: thrust = max n |n|
                wanted[i] = math.copysign(math.sqrt(abs(command) / high), command)
            else:
                wanted[i] = command
        for stage in range(3):
            for i in range(2):
                if stage > 0:
                    x[13 + i] = wanted[i] + (x[13 + i] - wanted[i]) * half
                n = x[13 + i]
                if by_revolutions:
                    thrust[stage, i] = high * (n * abs(n) - lost * abs(n) * x[7])
                else:
                    thrust[stage, i] = n
        slope(x, k1, numbers, M, inverse, D, across, along, outside, thrust[0])
        y[:] = x[:13] + 0.5 * h * k1
        slope(y, k2, numbers, M, inverse, D, across, along, outside, thrust[1])
        y[:] = x[:13] + 0.5 * h * k2
        slope(y, k3, numbers, M, inverse, D, across, along, outside, thrust[1])
        y[:] = x[:13] + h * k3
        slope(y, k4, numbers, M, inverse, D, across, along, outside, thrust[2])
        x[:13] += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        x[3:7] /= math.sqrt(x[3] ** 2 + x[4] ** 2 + x[5] ** 2 + x[6] ** 2)
        a, b, c, d = x[3], x[4], x[5], x[6]
        # first two rows of R(q)
        r00, r01, r02 = 1.0 - 2.0 * (c * c + d * d), 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)
        r10, r11, r12 = 2.0 * (b * c + a * d), 1.0 - 2.0 * (b * b + d * d), 2.0 * (c * d - a * b)
        gx, gy, gz = gravity[0], gravity[1], gravity[2]
        p, q, r = x[10], x[11], x[12]
        u, v, w = x[7] + q * gz - r * gy, x[8] + r * gx - p * gz, x[9] + p * gy - q * gx
        track[row, 0] = x[0] + r00 * gx + r01 * gy + r02 * gz
        track[row, 1] = x[1] + r10 * gx + r11 * gy + r12 * gz
        heading = math.atan2(r10, r00)
        x[15] = heading + 2.0 * math.pi * round((x[15] - heading) / (2.0 * math.pi))
        track[row, 2] = x[15]
        track[row, 3] = r00 * u + r01 * v + r02 * w + outside[0]
        track[row, 4] = r10 * u + r11 * v + r12 * w + outside[1]
        track[row, 5] = r
        track[row, 6], track[row, 7] = thrust[2, 0], thrust[2, 1]


@jit
def slope(
    x: Array,
    out: Array,
    numbers: Array,
    M: Array,
    inverse: Array,
    D: Array,
    across: Array,
    along: Array,
    outside: Array,
    thrust: Array,
) -> None:
    """Fill the derivative (13,) of position, quaternion and velocity."""
    a, b, c, d = x[3], x[4], x[5], x[6]
    u, v, w, p, q, r = x[7], x[8], x[9], x[10], x[11], x[12]
    r00, r01, r02 = 1.0 - 2.0 * (c * c + d * d), 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)
    r10, r11, r12 = 2.0 * (b * c + a * d), 1.0 - 2.0 * (b * b + d * d), 2.0 * (c * d - a * b)
    r20, r21, r22 = 2.0 * (b * d - a * c), 2.0 * (c * d + a * b), 1.0 - 2.0 * (b * b + c * c)
    out[0] = r00 * u + r01 * v + r02 * w + outside[0]
    out[1] = r10 * u + r11 * v + r12 * w + outside[1]
    out[2] = r20 * u + r21 * v + r22 * w
    out[3] = 0.5 * (-b * p - c * q - d * r)
    out[4] = 0.5 * (a * p + c * r - d * q)
    out[5] = 0.5 * (a * q + d * p - b * r)
    out[6] = 0.5 * (a * r + b * q - c * p)
    nu = x[7:13]
    momentum = (M * nu).sum(axis=1)
    f = -(D * nu).sum(axis=1) - numbers[:6] * np.abs(nu) * nu
    for k in range(across.shape[0]):
        at, area = across[k, 0], across[k, 1]
        side, down = v + at * r, w - at * q
        Y, Z = -area * abs(side) * side, -numbers[22] * area * abs(down) * down
        f[1] += Y
        f[2] += Z
        f[4] -= at * Z
        f[5] += at * Y
    for k in range(along.shape[0]):
        ahead = u - along[k, 0] * r
        X = -along[k, 1] * abs(ahead) * ahead
        f[0] += X
        f[5] -= along[k, 0] * X
    fin, at = numbers[23], numbers[24]
    Y, Z = -fin * abs(u) * (v + at * r), -fin * abs(u) * (w - at * q)
    f[1] += Y
    f[2] += Z
    f[4] -= at * Z
    f[5] += at * Y + numbers[25] * u * v
    roll, pitch = math.atan2(r21, r22), -math.asin(min(max(r20, -1.0), 1.0))
    for i in range(3):
        f[2 + i] -= numbers[6 + 3 * i] * x[2] + numbers[7 + 3 * i] * roll + numbers[8 + 3 * i] * pitch
    # the wind's force in the body frame
    f[0] += r00 * outside[2] + r10 * outside[3]
    f[1] += r01 * outside[2] + r11 * outside[3]
    f[2] += r02 * outside[2] + r12 * outside[3]
    port, starboard = outside[4] * thrust[0], outside[5] * thrust[1]
    f[0] += port + starboard
    f[5] += numbers[15] * port - numbers[16] * starboard
    l0, l1, l2, h0, h1, h2 = momentum[0], momentum[1], momentum[2], momentum[3], momentum[4], momentum[5]
    f[0] -= q * l2 - r * l1
    f[1] -= r * l0 - p * l2
    f[2] -= p * l1 - q * l0
    f[3] -= q * h2 - r * h1 + v * l2 - w * l1
    f[4] -= r * h0 - p * h2 + w * l0 - u * l2
    f[5] -= p * h1 - q * h0 + u * l1 - v * l0
    out[7:] = (inverse * f).sum(axis=1)


def rigid_body_inertia(mass_kg: float, gravity_m: tuple[float, float, float], about_gravity: Array) -> Array:
    """Return the inertia matrix (6, 6) about the geometric centre.

    Parameters
    ----------
    mass_kg : mass in air.
    gravity_m : centre of gravity.
    about_gravity : (3, 3) inertia about the centre of gravity (kg m2).
    """
    S = np.cross(np.eye(3), gravity_m)  # S a = gravity_m x a
    M = np.zeros((6, 6))
    M[:3, :3] = mass_kg * np.eye(3)
    M[:3, 3:] = -mass_kg * S
    M[3:, :3] = mass_kg * S
    M[3:, 3:] = about_gravity - mass_kg * S @ S
    return M
