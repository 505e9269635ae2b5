"""The vertical thruster's own law: it holds a depth, or follows a ramp down to it, and does nothing else.

With depth error e = z_ref - z, rate error e' = w_ref - w, and the model's M_z, d_z, D_z and B - W:

    F3 = (B - W) + (d_z + D_z |w_ref|) w_ref  +  M_z (w0^2 e + 2 zeta w0 e') + integral of M_z w0^2 / T_i e

inside box and slew. The feed-forward is the whole thrust on a steady ramp; in the paper's descent it is the thruster's
maximum. The integral stands still while the command is limited, else it would wind up over a ramp that is too fast.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.flow import advance_heave
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle

NATURAL_RADPS = 0.3
"""w0: slow against the thruster's lag, fast against a descent."""
DAMPING = 1.0
"""zeta: no overshoot."""
INTEGRAL_S = 20.0
"""T_i: several times 1 / w0, so that it only takes up what the feed-forward misses."""


@kernel
def _follow(
    z: float,
    w: float,
    F: float,
    command: float,
    integral: float,
    z_ref: Array,
    w_ref: Array,
    h: float,
    low: float,
    high: float,
    slew: float,
    w0: float,
    zeta: float,
    Ti: float,
    p: Coefficients,
) -> tuple[Array, Array, float]:
    """Depths (N+1,), commands (N+1,) at the knots, and the integral's rate (N/s) over the first stage."""
    N = len(z_ref) - 1
    depth, commands = np.empty(N + 1), np.empty(N + 1)
    depth[0], commands[0] = z, command
    rate_now = 0.0
    for k in range(N):
        e, rate = z_ref[k + 1] - z, w_ref[k + 1] - w
        # F3 = (B - W) + (d_z + D_z |w_ref|) w_ref + M_z (w0^2 e + 2 zeta w0 e') + integral
        feed = p.net_buoyancy + (p.linear_heave + p.quadratic_heave * abs(w_ref[k + 1])) * w_ref[k + 1]
        wanted = feed + p.mass_heave * (w0 * w0 * e + 2.0 * zeta * w0 * rate) + integral
        limited = min(max(wanted, low, command - slew * h), high, command + slew * h)
        if limited == wanted:
            integral += p.mass_heave * w0 * w0 / Ti * e * h
            if k == 0:
                rate_now = p.mass_heave * w0 * w0 / Ti * e
        z, w, F = advance_heave(z, w, F, command, limited, h, p)
        command = limited
        depth[k + 1], commands[k + 1] = z, command
    return depth, commands, rate_now


@dataclass(frozen=True, slots=True)
class VerticalPlan:
    """What the vertical thruster will do and where that leads, at the knots."""

    depth_m: Array  # (N+1,)
    thrust_N: Array  # (N+1,) commands
    integral_rate_N_per_s: float  # at the first knot: cycles may be any time apart


class VerticalLaw:
    """The law above for one vehicle."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._p = vehicle.coefficients()
        self._thruster = vehicle.thruster.vertical

    def plan(
        self,
        *,
        depth_m: float,
        sinking_mps: float,
        thrust_N: float,
        command_N: float,
        integral_N: float,
        depth_ref_m: Array,
        sinking_ref_mps: Array,
        stage_s: float,
    ) -> VerticalPlan:
        """Follow ``depth_ref_m`` (N+1,) at the knots from the state at the first."""
        t = self._thruster
        depth, thrust, rate = _follow(
            depth_m,
            sinking_mps,
            thrust_N,
            command_N,
            integral_N,
            depth_ref_m,
            sinking_ref_mps,
            stage_s,
            t.min_N,
            t.max_N,
            t.slew_N_per_s,
            NATURAL_RADPS,
            DAMPING,
            INTEGRAL_S,
            self._p,
        )
        return VerticalPlan(depth, thrust, rate)
