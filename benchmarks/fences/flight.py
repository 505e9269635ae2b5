"""Flight of one scene: what it kept from the zones, and its way."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.fences.scenes import Scene, estimate_at_start, obstacle_at, scene_of, settings_of
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.geofence.zones import clearances, pack_zones
from ltv_mpc.messages import Array, Obstacles, Pair, SolveStatus
from ltv_mpc.references import Point
from sim.motion import apply_mismatch
from sim.scenario import Mismatch

CYCLE_NS = 300_000_000
REPORT_S = 10.0
PARTS = 3
"""Positions per cycle of which the clearance is taken."""

HEAVY = Mismatch(mass=1.3, drag=0.7, thrust=0.8)
"""The vehicle that stops worst: its mass, drag and thrust over those of its file."""

CORNER = 0.3
"""Largest error of mass, drag and thrust of the vehicles that are drawn."""


class Job(NamedTuple):
    """Flight of one scene."""

    seed: int
    moving: bool
    report_s: float = REPORT_S  # time between two reports of an obstacle
    model: str = "right"  # a key of ``MODELS``


class Flown(NamedTuple):
    """Figures of one flight."""

    clearance_m: float  # least distance between hull and zones; negative: violated
    entered_m: float  # largest depth in a margin, 0 if none was entered
    arrived: bool
    duration_s: float
    way_m: float
    unsolved_s: list[float]  # times of the cycles whose QP was not solved
    cycles: int
    track_m: list[Pair]  # position after each cycle


def drawn(seed: int) -> Mismatch:
    """Return a vehicle whose mass, drag and thrust are each ``CORNER`` more or less than those of its file."""
    mass, drag, thrust = (1.0 + CORNER * np.random.default_rng([32, seed]).choice((-1.0, 1.0), 3)).tolist()
    return Mismatch(mass=mass, drag=drag, thrust=thrust)


MODELS: dict[str, Callable[[int], Mismatch]] = {"right": lambda _: Mismatch(), "heavy": lambda _: HEAVY, "drawn": drawn}
"""How the true vehicle differs from the file of the controller, by the seed of the scene."""


def fly(job: Job) -> Flown:
    """Fly one scene."""
    scene = scene_of(job.seed, moving=job.moving)
    vehicle, estimate = scene.vehicle, estimate_at_start(scene)
    near_m = characteristic_scales(vehicle).length_m
    controller = Controller(vehicle, Point(north_m=scene.goal[0], east_m=scene.goal[1]), settings_of(scene.name))
    controller.set_fence(scene.fence)
    prediction, true = Prediction(vehicle), MODELS[job.model](job.seed)
    prediction.coefficients[:] = apply_mismatch(vehicle.coefficients(), true)
    prediction.set_shares(true.thrusts[:2])
    track, times, cycles = [(estimate.north_m, estimate.east_m)], [0.0], 0
    unsolved: list[float] = []
    arrived = False
    while estimate.t_ns < scene.duration_s * 1e9 and not arrived:
        t_ns = estimate.t_ns
        if scene.obstacle is not None and t_ns % round(job.report_s * 1e9) < CYCLE_NS:
            controller.add_obstacles(Obstacles(t_ns=t_ns, obstacles=(obstacle_at(scene.obstacle, t_ns),)))
        plan = controller.plan(estimate)
        if plan.solve.status is not SolveStatus.SOLVED:
            unsolved.append(t_ns * 1e-9)
        prediction.sent.add(plan)
        cycles += 1
        for part in range(1, PARTS + 1):
            end = prediction.state_at(estimate, t_ns + part * CYCLE_NS // PARTS)
            track.append((float(end.lateral[0]), float(end.lateral[1])))
            times.append((t_ns + part * CYCLE_NS // PARTS) * 1e-9)
        estimate = as_estimate(end, estimate)
        arrived = math.dist(track[-1], scene.goal) < near_m
    points = np.array(track)
    least, entered = keeps(scene, points, np.array(times))
    return Flown(
        clearance_m=least,
        entered_m=entered,
        arrived=arrived,
        duration_s=times[-1],
        way_m=float(np.hypot(*np.diff(points, axis=0).T).sum()),
        unsolved_s=unsolved,
        cycles=cycles,
        track_m=[(round(n, 3), round(e, 3)) for n, e in track[::PARTS]],
    )


def keeps(scene: Scene, points: Array, t_s: Array) -> tuple[float, float]:
    """Return the least clearance of the hull, and the largest depth in a margin (m)."""
    assert scene.vehicle.hull is not None
    hull_m, least, entered = scene.vehicle.hull.radius_m, math.inf, 0.0
    if scene.fence is not None:
        zones = pack_zones(scene.fence)
        free = clearances(zones, points) - hull_m
        least = float(free.min())
        entered = max(float((zones.margin - free).max()), 0.0)
    if scene.obstacle is not None:
        o = scene.obstacle
        place = np.column_stack([o.north_m + t_s * o.velocity_north_mps, o.east_m + t_s * o.velocity_east_mps])
        least = min(least, float(np.hypot(*(points - place).T).min()) - o.radius_m - hull_m)
    return least, entered
