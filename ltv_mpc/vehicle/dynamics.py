"""Equations of motion of an underactuated vehicle with two stern thrusters, and their Jacobians.

State     x  = [n, e, u, v, psi, r]  position (m, NED), velocity through the water (m/s, FRD), heading (rad), yaw
                                     rate (rad/s)
Input     F  = [F1, F2]              port and starboard thrust as delivered (N)
Exogenous c  = [c_n, c_e]            water velocity at the vehicle (m/s, NED)
          cr = [cr_n, cr_e]          rate of c along the vehicle's path, dc/dz w (m/s2, NED)

    M_x u' = F1 + F2 - (d_x + D_x |u|) u + M_y v r - m [ cos psi, sin psi] . cr
    M_y v' =         - (d_y + D_y |v|) v - M_x u r - m [-sin psi, cos psi] . cr
    I_z r' = F1 a1 - F2 a2 - (d_psi + D_psi |r|) r + M_m u v + N
    n' = cos psi u - sin psi v + c_n,   e' = sin psi u + cos psi v + c_e,   psi' = r
    M_z w' = F3 - (d_z + D_z |w|) w - (B - W),   z' = w

M_m = M_x - M_y and N = 0 are those of the paper; the controller may learn others (``control/disturbance.py``).

Source: Medagoda & Williams 2012, eq 2 to 7; the sway Coriolis term has the sign of eq 6, not of Algorithm 1; the
restoring force is on the right-hand side. The term with the dry mass m is the acceleration of the water along the path
of the vehicle in shear: the dry mass keeps its velocity over ground, and the added mass moves with the water.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Coefficients


@jit
def coefficients(flat: Array) -> Coefficients:
    """Return the coefficients from an array (21,), the inverse of ``np.array(vehicle.coefficients())``."""
    return Coefficients(
        flat[0], flat[1], flat[2], flat[3], flat[4], flat[5], flat[6], flat[7], flat[8], flat[9], flat[10], flat[11],
        flat[12], flat[13], flat[14], flat[15], flat[16], flat[17], flat[18], flat[19], flat[20],
    )  # fmt: skip


@jit
def rates(
    u: float,
    v: float,
    psi: float,
    r: float,
    F1: float,
    F2: float,
    cn: float,
    ce: float,
    crn: float,
    cre: float,
    p: Coefficients,
) -> tuple[float, float, float, float, float, float]:
    """Return n', e', u', v', psi', r' by the equations above.

    Eleven scalars instead of arrays, because the innermost kernels keep the state in registers.

    Parameters
    ----------
    u, v : velocity through the water (m/s).
    psi, r : heading (rad) and yaw rate (rad/s).
    F1, F2 : delivered thrust of port and starboard (N).
    cn, ce : current north and east (m/s).
    crn, cre : rate of the current along the path (m/s2).
    p : coefficients of the vehicle.
    """
    cos, sin = math.cos(psi), math.sin(psi)
    # n' = cos psi u - sin psi v + c_n,  e' = sin psi u + cos psi v + c_e
    dn = cos * u - sin * v + cn
    de = sin * u + cos * v + ce
    # M_x u' = F1 + F2 - (d_x + D_x |u|) u + M_y v r - m [cos psi, sin psi] . cr
    surge = F1 + F2 - (p.linear_surge + p.quadratic_surge * abs(u)) * u
    du = (surge + p.mass_sway * v * r - p.dry_mass * (cos * crn + sin * cre)) / p.mass_surge
    # M_y v' = - (d_y + D_y |v|) v - M_x u r - m [-sin psi, cos psi] . cr
    sway = -(p.linear_sway + p.quadratic_sway * abs(v)) * v
    dv = (sway - p.mass_surge * u * r - p.dry_mass * (cos * cre - sin * crn)) / p.mass_sway
    # I_z r' = F1 a1 - F2 a2 - (d_psi + D_psi |r|) r + M_m u v + N
    yaw = F1 * p.arm_port - F2 * p.arm_starboard + p.yaw_moment - (p.linear_yaw + p.quadratic_yaw * abs(r)) * r
    dr = (yaw + (p.mass_surge - p.mass_sway + p.added_munk) * u * v) / p.inertia_yaw
    return dn, de, du, dv, r, dr


class Slopes(NamedTuple):
    """Entries of df/dx that depend on the state, named by row and column; of the others dpsi'/dr is 1, the rest 0."""

    n_u: float
    n_v: float
    n_psi: float
    e_u: float
    e_v: float
    e_psi: float
    u_u: float
    u_v: float
    u_psi: float
    u_r: float
    v_u: float
    v_v: float
    v_psi: float
    v_r: float
    r_u: float
    r_v: float
    r_r: float


@jit
def slopes(u: float, v: float, psi: float, r: float, crn: float, cre: float, p: Coefficients) -> Slopes:
    """Return the entries of df/dx at a state, with d(q|q|)/dq = 2|q|.

    Parameters
    ----------
    u, v : velocity through the water (m/s).
    psi, r : heading (rad) and yaw rate (rad/s).
    crn, cre : rate of the current along the path (m/s2).
    p : coefficients of the vehicle.
    """
    cos, sin = math.cos(psi), math.sin(psi)
    along, across = cos * crn + sin * cre, cos * cre - sin * crn
    # divide once: a division costs as much as ten products, and a horizon needs two hundred evaluations
    of_surge, of_sway, of_yaw = 1.0 / p.mass_surge, 1.0 / p.mass_sway, 1.0 / p.inertia_yaw
    return Slopes(
        n_u=cos,
        n_v=-sin,
        n_psi=-sin * u - cos * v,
        e_u=sin,
        e_v=cos,
        e_psi=cos * u - sin * v,
        u_u=-(p.linear_surge + 2.0 * p.quadratic_surge * abs(u)) * of_surge,
        u_v=p.mass_sway * r * of_surge,
        u_psi=-p.dry_mass * across * of_surge,
        u_r=p.mass_sway * v * of_surge,
        v_u=-p.mass_surge * r * of_sway,
        v_v=-(p.linear_sway + 2.0 * p.quadratic_sway * abs(v)) * of_sway,
        v_psi=p.dry_mass * along * of_sway,
        v_r=-p.mass_surge * u * of_sway,
        r_u=(p.mass_surge - p.mass_sway + p.added_munk) * v * of_yaw,
        r_v=(p.mass_surge - p.mass_sway + p.added_munk) * u * of_yaw,
        r_r=-(p.linear_yaw + 2.0 * p.quadratic_yaw * abs(r)) * of_yaw,
    )


@jit
def heave_acceleration(w: float, F3: float, p: Coefficients) -> float:
    """Return w' (m/s2): M_z w' = F3 - (d_z + D_z |w|) w - (B - W).

    Parameters
    ----------
    w : sinking speed (m/s).
    F3 : delivered vertical thrust (N), positive down.
    p : coefficients of the vehicle.
    """
    return (F3 - (p.linear_heave + p.quadratic_heave * abs(w)) * w - p.net_buoyancy) / p.mass_heave
