"""scipy's least_squares on the commands alone: the paper's method, single shooting with differences for derivatives.

The roll-out is this project's compiled one. A bound on the slew has no place in least_squares: the commands that come
back are moved to the nearest that obey it, as every solver's are.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from benchmarks.peers.peer import Peer
from ltv_mpc.control.config import STAGE_NS
from ltv_mpc.control.linearisation import roll_out, velocity_over_ground
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import Array


class ScipyLeastSquares(Peer):
    """Residuals are the square roots of the cost's terms."""

    name = "scipy least_squares"
    solves = "NLP"
    settings = "trf with bounds, 2-point differences, commands over their maxima; defaults otherwise; no slew limit"

    def find(self) -> Result:
        """Solve from the guess."""
        F = self.limits.thrust_scale
        low, high = (bound / F for bound in self.box())
        start = np.clip(self.lin.U[1:] / F, low, high)
        found = least_squares(self._residuals, start.ravel(), bounds=(low.ravel(), high.ravel()))
        return self.answer(found.x.reshape(-1, 2) * F, iterations=int(found.nfev))

    def _residuals(self, x: Array) -> Array:
        w, lin, F = self.weights, self.lin, self.limits.thrust_scale
        U = np.vstack([lin.U[:1], x.reshape(-1, 2) * F])
        X = roll_out(lin.X[0], U, lin.C, np.full(self.stages, STAGE_NS * 1e-9), self.vehicle.coefficients())
        off = X[1:, :2] - self.reference
        velocity, _ = velocity_over_ground(X[-1], lin.C[-1])
        return np.concatenate(
            [
                np.sqrt(w.position_per_m2) * off.ravel(),
                np.sqrt(w.terminal_position_per_m2) * off[-1],
                np.sqrt(w.terminal_velocity_s2_per_m2) * velocity,
                np.sqrt(w.thrust) * x,
                np.sqrt(w.thrust_change) * (np.diff(U, axis=0) / F).ravel(),
            ]
        )
