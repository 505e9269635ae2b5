"""Model of the current: Gauss-Markov over depth, one value north and one east at each point of a depth grid.

Prior   c(z) = m + s(z):  m is common to all depths, with sd sigma_m;  s is first-order Gauss-Markov,
        cov(s(z1), s(z2)) = sigma^2 exp(-|z1 - z2| / L); north and east are independent. So an unobserved depth is
        predicted from its neighbours. With m, a tide of 0.2 m/s fits a prior whose shear is 0.04 m/s. m is a state
        that nothing measures directly: given m, each grid point depends on its neighbours alone.
Saved   A saved profile f(z) has sd(z), of which sd_common is shared by all depths; sd_new is the change of the water
        since then:  c(z) = f(z) + m + s(z),  sigma_m = sd_common,  and sigma^2 becomes
            sd_s(z)^2 = sd(z)^2 - sd_common^2 + sd_new^2 + bridge
        Between depths of the file at distances d1, d2 from z, with e_i = exp(-2 d_i / L), f and sd^2 are linear and
            bridge = sigma^2 (1 - e_1) (1 - e_2) / (1 - e_1 e_2)    variance of s given both ends
        Beyond its ends, at distance d from the nearest, with e = exp(-d / L):
            f = f_mean + e (f_end - f_mean),  sd_s^2 = e^2 sd_s,end^2 + (1 - e^2) (sigma^2 + sigma_m^2 - sd_common^2)
        so far away c has the standard deviation of the prior without a file, about the mean of the file over depth.
Between grid points c(z) is linear: c(z) = (1 - s) c_k + s c_{k+1},  s = z/h - k.
Time    Each grid point is a slow random walk: cov += q^2 dt.
Source  Medagoda & Williams 2012, section IV-A (first-order Gauss-Markov in depth).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, grid
from ltv_mpc.messages import Array, CurrentProfile


class NodePrior(NamedTuple):
    """Prior distribution of the current at all G grid points."""

    mean_mps: Array  # (G, 2)
    sd_mps: Array  # standard deviation of s, (G,)
    common_sd_mps: float  # standard deviation of m
    correlation: float  # of s, between neighbours

    def covariance(self) -> Array:
        """Return the covariance of c along one axis, (G, G) m2/s2. It includes m."""
        k = np.arange(len(self.sd_mps))
        covariance: Array = np.outer(self.sd_mps, self.sd_mps) * self.correlation ** np.abs(k[:, None] - k[None, :])
        return covariance + self.common_sd_mps**2


def node_prior(config: EstimatorConfig, saved: WaterPrior | None = None) -> NodePrior:
    """Return the prior of all grid points, from the settings or from a saved profile.

    Parameters
    ----------
    config : settings of the estimator.
    saved : profile of an earlier dive; None: still water with the standard deviations of ``config``.
    """
    z = grid(config)
    correlation = float(np.exp(-config.cell_m / config.current_correlation_length_m))
    if saved is None:
        sd = np.full(len(z), config.current_sd_mps)
        mean = np.zeros((len(z), 2))
        return NodePrior(mean_mps=mean, sd_mps=sd, common_sd_mps=config.current_mean_sd_mps, correlation=correlation)
    length = config.current_correlation_length_m
    usual, common = config.current_sd_mps**2, saved.sd_common_mps**2
    depth, f = saved.depth_m, np.stack([saved.north_mps, saved.east_mps], axis=1)
    own = np.maximum(saved.sd_mps**2 - common, 0.0) + config.water_prior_change_sd_mps**2

    # distances to the next depths of the file above and below; infinite if there is none
    after = np.searchsorted(depth, z)
    d1 = np.where(after > 0, z - depth[after - 1], np.inf)
    d2 = np.where(after < len(depth), depth[np.minimum(after, len(depth) - 1)] - z, np.inf)
    e1, e2 = np.exp(-2.0 * d1 / length), np.exp(-2.0 * d2 / length)
    inside = np.isfinite(d1 + d2) & (d1 > 0) & (d2 > 0)
    bridge = np.where(inside, usual * (1.0 - e1) * (1.0 - e2) / np.where(inside, 1.0 - e1 * e2, 1.0), 0.0)
    beyond = np.clip(z, depth[0], depth[-1]) - z
    e = np.exp(-np.abs(beyond) / length)

    far = np.maximum(usual + config.current_mean_sd_mps**2 - common, 0.0)
    variance = e**2 * (np.interp(z, depth, own) + bridge) + (1.0 - e**2) * far
    middle = np.trapezoid(f, depth, axis=0) / (depth[-1] - depth[0]) if len(depth) > 1 else f[0]
    mean = np.stack([m + e * (np.interp(z, depth, column) - m) for m, column in zip(middle, f.T, strict=True)], axis=1)
    return NodePrior(
        mean_mps=mean, sd_mps=np.sqrt(variance), common_sd_mps=saved.sd_common_mps, correlation=correlation
    )


def write_prior(belief: Belief, config: EstimatorConfig, saved: WaterPrior | None = None) -> None:
    """Write the prior of the current into a belief.

    Parameters
    ----------
    belief : state estimate without knowledge of the water; its water states change.
    config : settings of the estimator.
    saved : profile of an earlier dive, or None.
    """
    layout, prior = belief.layout, node_prior(config, saved)
    covariance = prior.covariance()
    for axis, nodes in enumerate((layout.north, layout.east)):
        m = layout.mean.start + axis
        belief.x[m], belief.x[nodes] = 0.0, prior.mean_mps[:, axis]
        belief.P[nodes, nodes] = covariance
        belief.P[m, m] = belief.P[m, nodes] = belief.P[nodes, m] = prior.common_sd_mps**2


def add_random_walk(belief: Belief, config: EstimatorConfig, dt: float) -> None:
    """Add the random walk of the current over a time to the covariance, P_kk += q^2 dt.

    Parameters
    ----------
    belief : state estimate; its covariance changes.
    config : q is ``current_change_mps_per_rts``.
    dt : time (s).
    """
    variance = config.current_change_mps_per_rts**2 * dt
    if variance > 0:
        nodes = np.arange(belief.layout.north.start, belief.layout.east.stop)
        belief.P[nodes, nodes] += variance


def profile(belief: Belief, depth_m: Array) -> CurrentProfile:
    """Return the current profile to publish.

    The standard deviation at a grid point is the larger of north and east.

    Parameters
    ----------
    belief : state estimate.
    depth_m : (G,) depths of the grid (m).
    """
    variance = np.diagonal(belief.P)
    north, east = belief.layout.north, belief.layout.east
    return CurrentProfile(
        depth_m=depth_m,
        north_mps=belief.x[north].copy(),
        east_mps=belief.x[east].copy(),
        sd_mps=np.sqrt(np.maximum(variance[north], variance[east])),
    )
