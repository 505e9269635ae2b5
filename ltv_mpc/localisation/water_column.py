"""The water as the filter knows it: Gauss-Markov over depth, one value north and one east at each node of a grid.

Prior   c(z) = m + s(z):  m one value for the whole column, sd sigma_m;  s first-order Gauss-Markov,
        cov(s(z1), s(z2)) = sigma^2 exp(-|z1 - z2| / L); north and east independent. An unseen cell is thus predicted
        from its neighbours; m lets a tide of 0.2 m/s pass a profile whose shear is 0.04 m/s.
Between c(z) is linear between nodes: c(z) = (1 - s) c_k + s c_{k+1},  s = z/h - k.
Time    each node may walk slowly: cov += q^2 dt.
Source  Medagoda & Williams 2012, section IV-A (first-order Gauss-Markov in depth).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.state import Belief, grid
from ltv_mpc.signals import Array, CurrentProfile


def prior_covariance(config: EstimatorConfig) -> Array:
    """Of the nodes' velocity along one axis before anything is measured, (K, K)."""
    z = grid(config)
    distance = np.abs(z[:, None] - z[None, :])
    covariance: Array = config.current_mean_sd_mps**2 + config.current_sd_mps**2 * np.exp(
        -distance / config.current_correlation_length_m
    )
    return covariance


def write_prior(belief: Belief, config: EstimatorConfig) -> None:
    """Mean zero and the prior's covariance into a belief that knows nothing of the water yet."""
    covariance = prior_covariance(config)
    for axis in (belief.layout.north, belief.layout.east):
        belief.x[axis] = 0.0
        belief.P[axis, axis] = covariance


def walk(belief: Belief, config: EstimatorConfig, dt: float) -> None:
    """The nodes' random walk over ``dt`` (s)."""
    q = config.current_change_mps_per_rts
    if q > 0:
        nodes = np.arange(belief.layout.north.start, belief.layout.east.stop)
        belief.P[nodes, nodes] += q * q * dt


def profile(belief: Belief, depth_m: Array) -> CurrentProfile:
    """What is published; the standard deviation of a node is the larger of north's and east's."""
    variance = np.diagonal(belief.P)
    north, east = belief.layout.north, belief.layout.east
    return CurrentProfile(
        depth_m=depth_m,
        north_mps=belief.x[north].copy(),
        east_mps=belief.x[east].copy(),
        sd_mps=np.sqrt(np.maximum(variance[north], variance[east])),
    )
