"""Motion of an underactuated vehicle with two stern thrusters: equations and their Jacobians.

State     x  = [n, e, u, v, psi, r]  position (m, NED), velocity through the water (m/s, FRD), heading (rad), its rate
Input     F  = [F1, F2]              port and starboard thrust as delivered (N)
Exogenous c  = [c_n, c_e]            water velocity at the vehicle (m/s, NED)
          cr = [cr_n, cr_e]          its rate along the vehicle's path, dc/dz w (m/s2, NED)

    M_x u' = F1 + F2 - (d_x + D_x |u|) u + M_y v r - m [ cos psi, sin psi] . cr
    M_y v' =         - (d_y + D_y |v|) v - M_x u r - m [-sin psi, cos psi] . cr
    I_z r' = F1 a1 - F2 a2 - (d_psi + D_psi |r|) r + (M_x - M_y) u v
    n' = cos psi u - sin psi v + c_n,   e' = sin psi u + cos psi v + c_e,   psi' = r
    M_z w' = F3 - (d_z + D_z |w|) w - (B - W),   z' = w

Source: Medagoda & Williams 2012, eq 2 to 7; the sway Coriolis term has the sign of eq 6, not of Algorithm 1; the
restoring force stands on the right-hand side. The term with the dry mass m is the water's acceleration as the vehicle
meets it in shear: its mass keeps its velocity over ground, the added mass goes with the water.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.parameters import Coefficients

N, E, U, V, PSI, R = range(6)


@kernel
def derivative(x: Array, F: Array, c: Array, cr: Array, p: Coefficients, dx: Array) -> None:
    """dx = f(x, F, c, cr), shape (6,), written into ``dx``."""
    u, v, r = x[2], x[3], x[5]
    cos, sin = np.cos(x[4]), np.sin(x[4])
    # n' = cos psi u - sin psi v + c_n,  e' = sin psi u + cos psi v + c_e
    dx[0] = cos * u - sin * v + c[0]
    dx[1] = sin * u + cos * v + c[1]
    # M_x u' = F1 + F2 - (d_x + D_x |u|) u + M_y v r - m [cos psi, sin psi] . cr
    surge = F[0] + F[1] - (p.linear_surge + p.quadratic_surge * abs(u)) * u
    dx[2] = (surge + p.mass_sway * v * r - p.dry_mass * (cos * cr[0] + sin * cr[1])) / p.mass_surge
    # M_y v' = - (d_y + D_y |v|) v - M_x u r - m [-sin psi, cos psi] . cr
    sway = -(p.linear_sway + p.quadratic_sway * abs(v)) * v
    dx[3] = (sway - p.mass_surge * u * r - p.dry_mass * (cos * cr[1] - sin * cr[0])) / p.mass_sway
    dx[4] = r
    # I_z r' = F1 a1 - F2 a2 - (d_psi + D_psi |r|) r + (M_x - M_y) u v
    yaw = F[0] * p.arm_port - F[1] * p.arm_starboard - (p.linear_yaw + p.quadratic_yaw * abs(r)) * r
    dx[5] = (yaw + (p.mass_surge - p.mass_sway) * u * v) / p.inertia_yaw


@kernel
def jacobian(x: Array, cr: Array, p: Coefficients, J: Array) -> None:
    """J = df/dx, shape (6, 6), written into ``J`` (d(q|q|)/dq = 2|q|). Position columns are zero."""
    u, v, r = x[2], x[3], x[5]
    cos, sin = np.cos(x[4]), np.sin(x[4])
    J[:, :] = 0.0
    J[0, 2] = cos
    J[0, 3] = -sin
    J[0, 4] = -sin * u - cos * v
    J[1, 2] = sin
    J[1, 3] = cos
    J[1, 4] = cos * u - sin * v
    J[2, 2] = -(p.linear_surge + 2.0 * p.quadratic_surge * abs(u)) / p.mass_surge
    J[2, 3] = p.mass_sway * r / p.mass_surge
    J[2, 4] = -p.dry_mass * (cos * cr[1] - sin * cr[0]) / p.mass_surge
    J[2, 5] = p.mass_sway * v / p.mass_surge
    J[3, 2] = -p.mass_surge * r / p.mass_sway
    J[3, 3] = -(p.linear_sway + 2.0 * p.quadratic_sway * abs(v)) / p.mass_sway
    J[3, 4] = p.dry_mass * (cos * cr[0] + sin * cr[1]) / p.mass_sway
    J[3, 5] = -p.mass_surge * u / p.mass_sway
    J[4, 5] = 1.0
    J[5, 2] = (p.mass_surge - p.mass_sway) * v / p.inertia_yaw
    J[5, 3] = (p.mass_surge - p.mass_sway) * u / p.inertia_yaw
    J[5, 5] = -(p.linear_yaw + 2.0 * p.quadratic_yaw * abs(r)) / p.inertia_yaw


@kernel
def thrust_gain(p: Coefficients, G: Array) -> None:
    """G = df/dF, shape (6, 2), written into ``G``; it does not depend on the state."""
    G[:, :] = 0.0
    G[2, 0] = 1.0 / p.mass_surge
    G[2, 1] = 1.0 / p.mass_surge
    G[5, 0] = p.arm_port / p.inertia_yaw
    G[5, 1] = -p.arm_starboard / p.inertia_yaw


@kernel
def heave_acceleration(w: float, F3: float, p: Coefficients) -> float:
    """w' (m/s2): M_z w' = F3 - (d_z + D_z |w|) w - (B - W)."""
    return (F3 - (p.linear_heave + p.quadratic_heave * abs(w)) * w - p.net_buoyancy) / p.mass_heave
