"""Posterior Cramer-Rao bound of any estimator: linear covariance analysis of the sensors along a true trajectory."""

from sim.evaluation.cramer_rao_bound.analysis import Bound, bound
from sim.evaluation.cramer_rao_bound.model import Trajectory

__all__ = ["Bound", "Trajectory", "bound"]
