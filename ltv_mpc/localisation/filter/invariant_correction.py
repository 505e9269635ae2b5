"""Invariant correction: keep the heading unobservable by ADCP and IMU when the estimate moves.

ADCP and IMU do not observe heading. If velocity v, current c and attitude turn together about the vertical, every beam
reads the same. If errors are plain differences, the unobservable direction
    N(x) = [phi_d = 1, dv = z x v, dc_k = z x c_k],  z x [n, e] = [-e, n],
depends on the estimate. After each correction of v or c, earlier beams then seem to contradict later ones by phi_d
times the correction, and the filter gains false information about heading. (Without this step 2.0 deg of compass bias
became 1.8 deg within 60 s.) With the invariant error xi, v_true = v + xi + phi_d z x v, likewise for c, N is constant.
The filter stores plain differences. When the estimate moves by dx, its covariance is transformed through xi:
    P := M P M^T,  M = I + a e_phi_d^T,  a = z x dx on the rows of v, of every c_k and of their mean m, 0 elsewhere
Source  Barrau & Bonnabel 2017, IEEE T-AC 62(4) (invariant errors); Huang, Mourikis & Roumeliotis 2010, IJRR 29(5)
        (a filter stays consistent if its unobservable direction does not depend on the estimate).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import ATTITUDE, VELOCITY, Layout
from ltv_mpc.messages import Array

HEADING = ATTITUDE.stop - 1
"""Index of the heading error phi_d."""

_VELOCITY = VELOCITY.start


@jit
def coupling_vector(correction: Array, mean: int, north: int, east: int) -> Array:
    """Return the coupling vector a of the head of this file, with a[HEADING] = 0.

    Parameters
    ----------
    correction : (n,) error dx by which the estimate has just moved.
    mean : index of the mean current m, north; east is the next.
    north, east : index of the first grid point's current north and east.

    Returns
    -------
    (n,) a = z x dx.
    """
    a = np.zeros(len(correction))
    v = _VELOCITY
    a[v], a[v + 1] = -correction[v + 1], correction[v]
    a[mean], a[mean + 1] = -correction[mean + 1], correction[mean]
    for k in range(east - north):
        a[north + k], a[east + k] = -correction[east + k], correction[north + k]
    return a


def heading_coupling(correction: Array, layout: Layout) -> Array:
    """Return ``coupling_vector`` of a correction (n,) with the indices of ``layout``.

    Parameters
    ----------
    correction : (n,) error by which the estimate has just moved.
    layout : order of the states.
    """
    return coupling_vector(correction, layout.mean.start, layout.north.start, layout.east.start)
