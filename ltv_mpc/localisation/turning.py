"""What a correction does to the meaning of errors: velocity and water turn with the heading.

Profiler and inertial unit say nothing about heading: turn velocity v, water c and attitude together about the vertical,
and every beam reads the same. With errors taken as differences the direction of that turn,
    N(x) = [phi_d = 1, dv = z x v, dc_k = z x c_k],  z x [n, e] = [-e, n],
depends on the estimate, so each correction of v or c makes earlier beams seem to contradict later ones by phi_d times
the correction; the filter takes the contradiction for knowledge of the heading (2.0 deg of compass bias became 1.8 deg
within 60 s, out of nothing). Taken as v_true = v + xi + phi_d z x v, likewise c, errors have the same N everywhere.
The filter keeps differences, so when the estimate moves by dx it passes through xi:
    P := M P M^T,  M = I + a e_phi_d^T,  a = z x dx on the rows of v and of every c_k, 0 elsewhere
Source  Barrau & Bonnabel 2017, IEEE T-AC 62(4) (invariant errors); Huang, Mourikis & Roumeliotis 2010, IJRR 29(5) (why
        consistency follows from an unobservable direction that does not move).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.localisation.state import ATTITUDE, VELOCITY, Layout
from ltv_mpc.signals import Array

_HEADING = ATTITUDE.stop - 1


def turn_with_heading(P: Array, correction: Array, layout: Layout) -> None:
    """Carry P (n, n), symmetric, over to the estimate that ``correction`` (n,) has just moved; in place."""
    a = np.zeros(len(correction))
    north, east = VELOCITY.start, VELOCITY.start + 1
    a[north], a[east] = -correction[east], correction[north]
    a[layout.north], a[layout.east] = -correction[layout.east], correction[layout.north]
    _shear(P, a, _HEADING)


@kernel
def _shear(P: Array, a: Array, s: int) -> None:
    """P := (I + a e_s^T) P (I + a e_s^T)^T, with a[s] = 0: P_ij + a_i P_sj + (P_is + a_i P_ss) a_j."""
    h = P[s].copy()
    for i in range(P.shape[0]):
        b = h[i] + a[i] * h[s]
        for j in range(i + 1):
            P[i, j] += a[i] * h[j] + b * a[j]
            P[j, i] = P[i, j]
