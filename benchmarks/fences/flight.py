"""Flight of one scene by one method: what it kept from the zones, what it cost, its way."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.fences import full_loop
from benchmarks.fences.rivals import bent_controller, hard_controller, pid_commands, thrust_plan
from benchmarks.fences.scenes import Scene, estimate_at_start, obstacle_at, scene_of, settings_of
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.fence_clearance import PENALTY
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.scaling import characteristic_scales, state_scale
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.geofence.zones import clearances, pack_zones
from ltv_mpc.messages import Array, Obstacles, Pair, SolveStatus
from ltv_mpc.references import Point
from sim.motion import apply_mismatch
from sim.scenario import Mismatch

METHODS = ("fence", "hard", "bent", "pid", "ipopt", "sensors")
CYCLE_NS = 300_000_000
REPORT_S = 10.0
PARTS = 3
"""Positions per cycle of which the clearance is taken."""

HEAVY = Mismatch(mass=1.3, drag=0.7, thrust=0.8)
"""The vehicle that stops worst: its mass, drag and thrust over those of its file."""

CORNER = 0.3
"""Largest error of mass, drag and thrust of the vehicles that are drawn."""


class Job(NamedTuple):
    """Flight of one scene with one method."""

    seed: int
    method: str
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
    unsolved_s: list[float]  # times of the cycles whose QP or NLP was not solved
    cycles: int
    cost: float  # summed cost of the cycles (docs/notes/fences-study.md)
    sides: list[int]  # of the track on which each zone was left: 1 or -1
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
    if job.method == "sensors":
        return judged(scene, *full_loop.fly(scene, job.seed))
    vehicle, estimate = scene.vehicle, estimate_at_start(scene)
    near_m = characteristic_scales(vehicle).length_m
    controller = None if job.method == "pid" else _controller(scene, job.method)
    law = pid_commands(scene) if controller is None else None
    commands, prediction, true = SentCommands(vehicle), Prediction(vehicle), MODELS[job.model](job.seed)
    prediction.coefficients[:] = apply_mismatch(vehicle.coefficients(), true)
    prediction.set_shares(true.thrusts[:2])
    track, times, thrusts = [(estimate.north_m, estimate.east_m)], [0.0], [(0.0, 0.0)]
    unsolved: list[float] = []
    arrived = False
    while estimate.t_ns < scene.duration_s * 1e9 and not arrived:
        t_ns = estimate.t_ns
        if law is not None:
            plan = thrust_plan(vehicle, t_ns, CYCLE_NS, law(estimate), commands)
        else:
            assert controller is not None
            if scene.obstacle is not None and job.method != "bent" and t_ns % round(job.report_s * 1e9) < CYCLE_NS:
                controller.add_obstacles(Obstacles(t_ns=t_ns, obstacles=(obstacle_at(scene.obstacle, t_ns),)))
            plan = controller.plan(estimate)
            if plan.solve.status is not SolveStatus.SOLVED:
                unsolved.append(t_ns * 1e-9)
        commands.add(plan)
        for part in range(1, PARTS + 1):
            end = prediction.state_at(estimate, t_ns + part * CYCLE_NS // PARTS, commands)
            track.append((float(end.lateral[0]), float(end.lateral[1])))
            times.append((t_ns + part * CYCLE_NS // PARTS) * 1e-9)
        port, starboard = commands.at(np.array([t_ns + CYCLE_NS]))[0, :2]
        thrusts.append((float(port), float(starboard)))
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
        cycles=len(thrusts) - 1,
        cost=summed_cost(scene, points[::PARTS], np.array(thrusts)),
        sides=sides(scene, points),
        track_m=[(round(n, 3), round(e, 3)) for n, e in track[::PARTS]],
    )


def judged(scene: Scene, seen: full_loop.Seen, arrived: bool) -> Flown:
    """Return the figures of a flight with realistic sensors, by the true positions; its cost is not taken."""
    points = np.array(seen.track)
    least, entered = keeps(scene, points, np.array(seen.t_s))
    return Flown(
        clearance_m=least,
        entered_m=entered,
        arrived=arrived,
        duration_s=seen.t_s[-1],
        way_m=float(np.hypot(*np.diff(points, axis=0).T).sum()),
        unsolved_s=seen.unsolved_s,
        cycles=seen.cycles,
        cost=math.nan,
        sides=sides(scene, points),
        track_m=[(round(n, 3), round(e, 3)) for n, e in seen.track[::30]],
    )


def _controller(scene: Scene, method: str) -> Controller:
    """Return the controller of a method."""
    if method == "bent":
        return bent_controller(scene)
    if method == "hard":
        return hard_controller(scene)
    controller = Controller(scene.vehicle, Point(north_m=scene.goal[0], east_m=scene.goal[1]), settings_of(scene.name))
    controller.set_fence(scene.fence)
    if method == "ipopt":
        from benchmarks.fences.nonlinear import solve_with_ipopt  # needs casadi, which the other methods do not

        solve_with_ipopt(controller)
    return controller


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


def summed_cost(scene: Scene, points: Array, thrusts: Array) -> float:
    """Return the controller's stage cost summed over the cycles, with the point as the target.

    Parameters
    ----------
    scene : its point, its vehicle and its zones.
    points : (K+1, 2) positions at the cycles (m).
    thrusts : (K+1, 2) commands of port and starboard there (N).
    """
    w = settings_of(scene.name).weights
    share = thrusts / HorizonLimits.from_vehicle(scene.vehicle, CYCLE_NS * 1e-9).thrust_scale
    total = w.position_per_m2 * float(((points[1:] - scene.goal) ** 2).sum())
    total += w.thrust * float((share[1:] ** 2).sum()) + w.thrust_change * float((np.diff(share, axis=0) ** 2).sum())
    if scene.fence is not None and scene.vehicle.hull is not None:
        zones = pack_zones(scene.fence)
        lack = scene.vehicle.hull.radius_m + zones.margin - clearances(zones, points[1:])
        total += 2.0 * PENALTY * float(np.maximum(lack, 0.0).sum()) / state_scale(scene.vehicle)[0]
    return total


def sides(scene: Scene, points: Array) -> list[int]:
    """Return of each zone on which side the track leaves it: 1 if the bearing from its centre grows along the track."""
    if scene.fence is None:
        return []
    found = []
    for n, e, _ in pack_zones(scene.fence).circle:
        bearing = np.unwrap(np.arctan2(points[:, 1] - e, points[:, 0] - n))
        found.append(1 if bearing[-1] > bearing[0] else -1)
    return found
