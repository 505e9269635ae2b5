"""Equations of motion as CasADi expressions, for the peers that differentiate them themselves."""

from __future__ import annotations

from typing import Any

import casadi as ca

from ltv_mpc.vehicle.parameters import Coefficients


def rates(x: Any, F: Any, c: Any, cr: Any, p: Coefficients) -> Any:
    """Return [n', e', u', v', psi', r'] of x (6,) under thrusts F (2,), in a current c (2,) with rate of change cr.

    ``ltv_mpc/vehicle/dynamics.py``; a test holds the two together.
    """
    u, v, psi, r = x[2], x[3], x[4], x[5]
    cos, sin = ca.cos(psi), ca.sin(psi)
    surge = F[0] + F[1] - (p.linear_surge + p.quadratic_surge * ca.fabs(u)) * u
    sway = -(p.linear_sway + p.quadratic_sway * ca.fabs(v)) * v
    yaw = F[0] * p.arm_port - F[1] * p.arm_starboard + p.yaw_moment - (p.linear_yaw + p.quadratic_yaw * ca.fabs(r)) * r
    return ca.vertcat(
        cos * u - sin * v + c[0],
        sin * u + cos * v + c[1],
        (surge + p.mass_sway * v * r - p.dry_mass * (cos * cr[0] + sin * cr[1])) / p.mass_surge,
        (sway - p.mass_surge * u * r - p.dry_mass * (cos * cr[1] - sin * cr[0])) / p.mass_sway,
        r,
        (yaw + (p.mass_surge - p.mass_sway + p.added_munk) * u * v) / p.inertia_yaw,
    )


def velocity_over_ground(x: Any, c: Any) -> Any:
    """Return [n', e'] of a state."""
    cos, sin = ca.cos(x[4]), ca.sin(x[4])
    return ca.vertcat(cos * x[2] - sin * x[3] + c[0], sin * x[2] + cos * x[3] + c[1])


def stage(h: float, steps: int, p: Coefficients) -> Any:
    """Return the function (X (8,), u0, uh, c0, ch) -> X(h) (8,) of ``ltv_mpc/vehicle/flow.py``, integrated by
    Runge-Kutta 4 in ``steps`` steps.
    """
    inputs = [ca.SX.sym(name, size) for name, size in zip("Xuvcd", (8, 2, 2, 2, 2), strict=True)]
    return ca.Function("stage", inputs, [flow(*inputs, h, steps, p)])


def flow(X: Any, u0: Any, uh: Any, c0: Any, ch: Any, h: float, steps: int, p: Coefficients) -> Any:
    """Return X(h) as an expression; ``p`` may have expressions, but for the lags."""
    cr = (ch - c0) / h

    def thrust(t: float) -> Any:
        return ca.vertcat(*(
            _lagged(X[6 + i], u0[i], uh[i], t, h, lag) for i, lag in enumerate((p.lag_port, p.lag_starboard))
        ))  # fmt: skip

    def slope(x: Any, t: float) -> Any:
        return rates(x, thrust(t), c0 + cr * t, cr, p)

    x, d = X[:6], h / steps
    for i in range(steps):
        t = i * d
        k1 = slope(x, t)
        k2 = slope(x + d / 2 * k1, t + d / 2)
        k3 = slope(x + d / 2 * k2, t + d / 2)
        k4 = slope(x + d * k3, t + d)
        x = x + d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.vertcat(x, thrust(h))


def _lagged(F0: Any, u0: Any, uh: Any, t: float, h: float, lag: float) -> Any:
    s = (uh - u0) / h
    if lag <= 0.0:
        return u0 + s * t
    return u0 + s * t - lag * s + (F0 - u0 + lag * s) * ca.exp(-t / lag)
