"""Controller of this project, whole and without one of its parts.

preview        without: the current at its own depth is taken to be that of all depths
water          without: it is told no current; and, besides, may not estimate one as a disturbance
compensation   without: a plan that took D to compute is made for the state at the start of its cycle, and its first
               command is given when it is ready, so everything comes D late
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.loop import Loop, Outcome, Told
from benchmarks.rivals.search import Span
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.prediction import currents_at_depths
from ltv_mpc.messages import CurrentProfile, Estimate
from services.run.run_config import RunConfig

SPANS = {
    "terminal_position_per_m2": Span(1.0, 1000.0),
    "terminal_velocity_s2_per_m2": Span(10.0, 10_000.0),
    "thrust": Span(1e-5, 0.3),
    "thrust_change": Span(1e-5, 0.3),
}


class Variant(NamedTuple):
    """Controller without some of its parts."""

    preview: bool = True
    told_of_water: bool = True
    estimates_water: bool = True
    delay_s: float = 0.0
    compensates: bool = True

    @property
    def settings(self) -> tuple[str, ...]:
        """KEY=VALUE on top of the scenario."""
        disturbance = () if self.estimates_water else ("controller.disturbance.sd_mps=0.0",)
        return (f"run.compute_delay_s={self.delay_s}", *disturbance)

    @property
    def told(self) -> Told:
        """Function that returns the part of the truth that the controller receives."""
        if not self.told_of_water:
            return without_water
        return (lambda estimate: estimate) if self.preview else without_preview


def without_preview(estimate: Estimate) -> Estimate:
    """Return the estimate with the current of its own depth at all depths."""
    here = currents_at_depths(estimate.current, np.array([estimate.depth_m]))[0]
    everywhere = CurrentProfile(
        depth_m=np.array([0.0, 1.0]),
        north_mps=np.full(2, here[0]),
        east_mps=np.full(2, here[1]),
        sd_mps=np.zeros(2),
    )
    return msgspec.structs.replace(estimate, current=everywhere)


def without_water(estimate: Estimate) -> Estimate:
    """Return the estimate without any current."""
    return msgspec.structs.replace(estimate, current=None)


def fly(run_config: RunConfig, variant: Variant) -> Outcome:
    """Make the whole run."""
    controller = Controller(run_config.vehicle, run_config.reference, run_config.scenario.controller)
    return Loop(run_config=run_config, controller=controller, told=variant.told, compensates=variant.compensates).fly()
