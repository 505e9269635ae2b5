"""Benefit of the disturbance state if the controller does not know the current.

    .venv/bin/python -m benchmarks.unknown_current [--seeds N] [--only TEXT] [--workers N] [--out FILE.json]

The paper's descent, state known, in a current of 4 cm/s that is the same at all depths (another direction each seed),
or in the Gauss-Markov profile. "here": told the current at the vehicle's own depth, the most that an observer of the
vehicle's motion could find.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from benchmarks.loop import Loop, Told, run_config
from benchmarks.preview import without_preview
from benchmarks.table import Figures, Job, measure
from ltv_mpc.control.controller import Controller
from ltv_mpc.messages import Estimate
from sim.water import WaterColumn

SPEED_MPS = 0.04
TURN_RAD = 2.4
"""Angle by which the current turns from seed to seed."""

STATE, NO_STATE = "controller.disturbance.sd_mps=0.1", "controller.disturbance.sd_mps=0.0"
"""Always, never; as it is, where nobody tells of a current."""


def nothing(estimate: Estimate) -> Estimate:
    """Return the estimate without a current."""
    return msgspec.structs.replace(estimate, current=None)


def everything(estimate: Estimate) -> Estimate:
    """Return the estimate unchanged."""
    return estimate


def constant(depth_m: np.ndarray, seed: int) -> WaterColumn:
    """Return a current of 4 cm/s at all depths."""
    towards = np.array([np.cos(TURN_RAD * seed), np.sin(TURN_RAD * seed)])
    return WaterColumn(depth_m, np.full((len(depth_m), 2), SPEED_MPS) * towards)


WATERS = ("constant", "profile")
TOLD: dict[str, tuple[Told, tuple[str, ...]]] = {
    "nothing, none estimated": (nothing, (NO_STATE,)),
    "nothing": (nothing, ()),
    "here": (without_preview, ()),
    "all": (everything, ()),
    "all, disturbance state": (everything, (STATE,)),
}


def one(job: Job) -> Figures:
    """One descent."""
    water, row = job.row.split(": ")
    told, settings = TOLD[row]
    s = run_config(f"run.seed={job.seed}", *settings)
    if water == "constant":
        s = replace(s, water=constant(s.water.depth_m, job.seed))
    controller = Controller(s.vehicle, s.reference, s.scenario.controller)
    return Figures.of(Loop(run_config=s, controller=controller, told=told).fly())


if __name__ == "__main__":
    measure(__doc__, [f"{water}: {told}" for water in WATERS for told in TOLD], one)
