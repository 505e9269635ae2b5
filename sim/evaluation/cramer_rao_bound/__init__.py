"""How well any estimator could know the vehicle: linear covariance analysis of a suite along a true trajectory."""

from sim.evaluation.cramer_rao_bound.analysis import Bound, bound
from sim.evaluation.cramer_rao_bound.model import Trajectory

__all__ = ["Bound", "Trajectory", "bound"]
