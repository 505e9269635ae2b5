"""Flight of one scene with realistic sensors: all nodes in lock step, the vehicle dives to 10 m on its way.

Thirty satellite fixes come first; the vehicle drifts to the start meanwhile. The current of the scene is the same at
all depths, and only the estimator knows of it. The clearance is that of the true vehicle from t = 0 on.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.batch import Job
from benchmarks.fences.scenes import Scene
from ltv_mpc.config import to_toml
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.currents import write_profile
from ltv_mpc.messages import CurrentProfile, Message, Pair, Plan, PlanOrigin, SolveStatus, Truth
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point
from services.run.nodes import make_nodes
from services.run.run_config import RunConfig
from services.tools import lockstep_run
from sim.scheduler import LockStep, Observation

DIVING = ("paper", "low-yaw", "weak-reverse")
"""Vehicles with a vertical thruster."""

SURFACE_S = 30.0
DEPTH_M = 10.0
LOOK_NS = 3_000_000_000
"""Vehicle time between two looks at whether the vehicle has arrived."""


class Seen:
    """Observer of a run: true positions and cycles that were not solved."""

    def __init__(self) -> None:
        self.t_s: list[float] = []
        self.track: list[Pair] = []
        self.unsolved_s: list[float] = []
        self.cycles = 0

    types: frozenset[type[Message]] = frozenset({Truth, Plan})

    def published(self, _node: str, message: ReceivedMessage) -> None:
        """Take a message from t = 0 on."""
        content = message.message
        if isinstance(content, Truth) and content.t_ns >= 0:
            self.t_s.append(content.t_ns * 1e-9)
            self.track.append((content.position_m[0], content.position_m[1]))
        elif isinstance(content, Plan) and content.cycle_t_ns >= 0 and content.origin is not PlanOrigin.ZERO:
            self.cycles += 1
            if content.solve.status is not SolveStatus.SOLVED:
                self.unsolved_s.append(content.cycle_t_ns * 1e-9)


def fly(scene: Scene, seed: int) -> tuple[Seen, bool]:
    """Fly a scene until the true vehicle arrives or its time is over; return what was seen, and whether it arrived."""
    with tempfile.TemporaryDirectory() as folder:
        run_config = _run_config(scene, seed, Path(folder))
    seen, near_m = Seen(), characteristic_scales(scene.vehicle).length_m
    lockstep = LockStep(
        make_nodes(run_config),
        start_ns=run_config.scenario.start_ns,
        observation=Observation(seen, types=seen.types),
        latest=lockstep_run.LATEST,
        make_rejection=lockstep_run.rejected_message,
    )
    for t_ns in range(0, run_config.scenario.end_ns, LOOK_NS):
        lockstep.advance(t_ns)
        if seen.track and min(math.dist(at, scene.goal) for at in seen.track[-400:]) < near_m:
            return seen, True
    return seen, False


def _run_config(scene: Scene, seed: int, folder: Path) -> RunConfig:
    """Write the files of a scene, and resolve the run."""
    assert scene.fence is not None
    north, east = scene.water
    texts = {
        "vehicle": to_toml(scene.vehicle),
        "reference": to_toml(Point(north_m=scene.goal[0], east_m=scene.goal[1], depth_m=DEPTH_M)),
        "fence": to_toml(scene.fence),
    }
    for name, text in texts.items():
        (folder / f"{name}.toml").write_text(text)
    depth = np.array([0.0, 100.0])
    write_profile(
        folder / "water.csv",
        CurrentProfile(depth_m=depth, north_mps=np.full(2, north), east_mps=np.full(2, east)),
    )
    settings = {
        **{name: folder / f"{name}.toml" for name in texts},
        "sensors": "realistic",
        "run.seed": seed,
        "run.surface_time_s": SURFACE_S,
        "run.duration_s": scene.duration_s,
        "water.kind": "measured",
        "water.file": folder / "water.csv",
        "plant.heading_rad": scene.heading_rad,
        "plant.north_m": -SURFACE_S * north,
        "plant.east_m": -SURFACE_S * east,
    }
    return Job("descent", tuple(f"{key}={value}" for key, value in settings.items())).run_config()
