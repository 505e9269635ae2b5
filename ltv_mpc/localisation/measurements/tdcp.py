"""Time-differenced carrier phase: the change of position since the last satellite epoch.

z = [p_n - e_n, p_e - e_e] + n, where e is the clone of the position that the filter made at that epoch
Source  Medagoda & Williams 2012, section III; the clone is a stochastic clone (Roumeliotis & Burdick 2002).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.measurements.rows import Rows
from ltv_mpc.localisation.state import Belief
from ltv_mpc.localisation.suite import Tdcp
from ltv_mpc.signals import TdcpFix


def rows(belief: Belief, fix: TdcpFix, tdcp: Tdcp) -> Rows:
    """Two rows. The caller has made sure that the clone is that of ``fix.from_t_ns``."""
    e = belief.layout.epoch.start
    state = np.array([[0, e], [1, e + 1]])
    x = belief.x
    return Rows(
        state=state,
        partial=np.array([[1.0, -1.0], [1.0, -1.0]]),
        residual=np.array([fix.north_m - (x[0] - x[e]), fix.east_m - (x[1] - x[e + 1])]),
        variance=np.full(2, tdcp.displacement_sd_m**2),
    )
