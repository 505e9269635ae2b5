"""What a correction does to the meaning of errors: velocity and water turn with the heading.

Profiler and inertial unit say nothing about heading: turn velocity v, water c and attitude together about the vertical,
and every beam reads the same. With errors taken as differences the direction of that turn,
    N(x) = [phi_d = 1, dv = z x v, dc_k = z x c_k],  z x [n, e] = [-e, n],
depends on the estimate, so each correction of v or c makes earlier beams seem to contradict later ones by phi_d times
the correction; the filter takes the contradiction for knowledge of the heading (2.0 deg of compass bias became 1.8 deg
within 60 s, out of nothing). Taken as v_true = v + xi + phi_d z x v, likewise c, errors have the same N everywhere.
The filter keeps differences, so when the estimate moves by dx it passes through xi:
    P := M P M^T,  M = I + a e_phi_d^T,  a = z x dx on the rows of v, of every c_k and of their mean m, 0 elsewhere
Source  Barrau & Bonnabel 2017, IEEE T-AC 62(4) (invariant errors); Huang, Mourikis & Roumeliotis 2010, IJRR 29(5) (why
        consistency follows from an unobservable direction that does not move).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import ATTITUDE, VELOCITY, Layout
from ltv_mpc.messages import Array

HEADING = ATTITUDE.stop - 1
"""Place of phi_d."""

_VELOCITY = VELOCITY.start


@jit
def coupling_vector(correction: Array, mean: int, north: int, east: int) -> Array:
    """a, (n,), of the estimate that ``correction`` (n,) has just moved; a[HEADING] = 0.

    ``mean`` is the place of m, ``north`` and ``east`` those of the water's first node.
    """
    a = np.zeros(len(correction))
    v = _VELOCITY
    a[v], a[v + 1] = -correction[v + 1], correction[v]
    a[mean], a[mean + 1] = -correction[mean + 1], correction[mean]
    for k in range(east - north):
        a[north + k], a[east + k] = -correction[east + k], correction[north + k]
    return a


def heading_coupling(correction: Array, layout: Layout) -> Array:
    """``coupling_vector`` by the places of ``layout``."""
    return coupling_vector(correction, layout.mean.start, layout.north.start, layout.east.start)
