"""Fences in random scenes: violations and arrivals, beside the controller with a bent reference and a PID law.

    .venv/bin/python -m benchmarks.fences --out DIR [--scenes N] [--moving N] [--methods fence bent pid] [--workers N]

A scene is a point at the far end of a lane, 1 to 8 convex zones between (discs and polygons), a vehicle and a current
of up to half its top speed from any direction, which the controller knows. The gaps between the zones are at least 1.5
times hull, two margins and the drift of a turn into the current, as ``vehicle check`` counts it. With ``--moving`` an
obstacle crosses the lane instead, reported every 10 s. The vehicle moves as the model predicts, and its clearance is
taken every 0.1 s. Three methods:

    fence   the controller with the fence
    bent    the controller, with waypoints round the grown zones as its reference, and no fence
    pid     heading and surge to the same waypoints, by a cascade of P laws

A scene counts as violated if the hull is in a zone at any time, and as arrived if the vehicle has come within its
length scale of the point. Scenes that DIR has already are not flown again.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from rich.console import Console
from rich.progress import Progress

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.fallback import NOT_RUN
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.geofence.fence import Disc, Fence, Polygon
from ltv_mpc.geofence.route import Router
from ltv_mpc.geofence.zones import clearances, pack_zones
from ltv_mpc.messages import Array, CurrentProfile, Estimate, Obstacle, Obstacles, Pair, Plan, PlanOrigin, SolveStatus
from ltv_mpc.references import Place, Point, Waypoints
from ltv_mpc.vehicle.parameters import Hull, Vehicle
from ltv_mpc.vehicle.performance import performance
from services.tools.batch.executor import run_each
from services.tools.batch.results_store import open_store

VEHICLES = ("paper", "low-yaw", "surface", "weak-reverse")
METHODS = ("fence", "bent", "pid")
CYCLE_NS = 300_000_000
REPORT_NS = 10_000_000_000
GAP_FACTOR = 1.5


class Scene(NamedTuple):
    """One scene."""

    vehicle: Vehicle
    fence: Fence | None
    obstacle: Obstacle | None
    goal: Pair
    water: Pair
    heading_rad: float
    duration_s: float


class Job(NamedTuple):
    """Flight of one scene with one method."""

    seed: int
    method: str
    moving: bool


class Flown(NamedTuple):
    """Figures of one flight."""

    clearance_m: float  # least distance between hull and zones; negative: violated
    entered_m: float  # largest depth in a margin, 0 if none was entered
    arrived: bool
    duration_s: float
    way_m: float
    unsolved: int
    cycles: int


def vehicle_of(name: str) -> Vehicle:
    """Return a vehicle with a hull of half its length scale if its file has none."""
    vehicle = Vehicle.load(name)
    if vehicle.hull is not None:
        return vehicle
    length = 0.3 * characteristic_scales(vehicle).length_m
    return msgspec.structs.replace(vehicle, hull=Hull(length_m=length, beam_m=0.4 * length))


def scene_of(seed: int, *, moving: bool) -> Scene:
    """Draw a scene."""
    rng = np.random.default_rng([31, seed, int(moving)])
    vehicle = vehicle_of(VEHICLES[rng.integers(len(VEHICLES))])
    assert vehicle.hull is not None
    scales, can = characteristic_scales(vehicle), performance(vehicle)
    speed = rng.uniform(0.0, 0.5) * scales.speed_mps
    angle = rng.uniform(-math.pi, math.pi)
    water = speed * math.cos(angle), speed * math.sin(angle)
    L = scales.length_m
    margin = 0.15 * L
    needed = 2.0 * vehicle.hull.radius_m + 2.0 * margin + speed * (can.turn_90deg_s or 0.0)
    gap, size = GAP_FACTOR * needed, max(L, 0.5 * needed)
    count = 0 if moving else int(rng.integers(1, 9))
    lane = 6.0 * size + 3.0 * gap
    places: list[tuple[float, float, float]] = []
    for _ in range(2000):
        if len(places) == count:
            break
        radius = rng.uniform(0.4, 1.5) * size
        north, east = rng.uniform(0.15, 0.85) * lane, rng.uniform(-0.35, 0.35) * lane
        ends = min(math.hypot(north, east), math.hypot(north - lane, east)) - radius
        if ends > gap and all(math.dist((north, east), (a, b)) - radius - r > gap for a, b, r in places):
            places.append((north, east, radius))
    discs, polygons = [], []
    for north, east, radius in places:
        if rng.random() < 0.5:
            discs.append(Disc(centre=Place(north_m=north, east_m=east), radius_m=radius))
        else:
            corners = np.sort(rng.uniform(0.0, 2.0 * math.pi, int(rng.integers(3, 7))))
            corners += np.linspace(0.0, 1e-3, len(corners))
            ring = tuple(
                Place(north_m=north + radius * math.cos(a), east_m=east + radius * math.sin(a)) for a in corners
            )
            polygons.append(Polygon(vertices=ring))
    fence = Fence(margin_m=margin, keep_out=tuple(polygons), keep_out_disc=tuple(discs)) if places else None
    duration_s = 4.0 * lane / (0.5 * scales.speed_mps) + 20.0 * (can.turn_90deg_s or 1.0)
    obstacle = None
    if moving:
        own, course = rng.uniform(0.2, 0.8) * scales.speed_mps, rng.uniform(-math.pi, math.pi)
        meets_s = rng.uniform(0.3, 1.2) * lane / scales.speed_mps
        v = own * math.cos(course), own * math.sin(course)
        obstacle = Obstacle(
            id=1, t_ns=0, north_m=0.5 * lane - v[0] * meets_s, east_m=-v[1] * meets_s,
            velocity_north_mps=v[0], velocity_east_mps=v[1], radius_m=0.5 * L,
        )  # fmt: skip
    heading = rng.uniform(-math.pi, math.pi)
    return Scene(vehicle, fence, obstacle, (lane, 0.0), water, heading, duration_s)


def estimate_at_start(scene: Scene) -> Estimate:
    """Return the first estimate: at rest in the water."""
    profile = CurrentProfile(
        depth_m=np.array([0.0, 1.0]), north_mps=np.full(2, scene.water[0]), east_mps=np.full(2, scene.water[1])
    )
    return msgspec.structs.replace(
        Estimate.at_rest(heading_rad=scene.heading_rad),
        velocity_north_mps=scene.water[0],
        velocity_east_mps=scene.water[1],
        current=profile,
    )


def waypoints(scene: Scene) -> list[Pair]:
    """Return the corners of the shortest way round the grown zones, and the goal."""
    if scene.fence is None or scene.vehicle.hull is None:
        return [scene.goal]
    zones = pack_zones(scene.fence)
    way = Router(zones, scene.vehicle.hull.radius_m + zones.margin).way(np.zeros(2), np.array(scene.goal))
    return [(float(n), float(e)) for n, e in way]


def controller_of(scene: Scene, method: str) -> Controller:
    """Return the controller of a method."""
    point = Point(north_m=scene.goal[0], east_m=scene.goal[1])
    if method == "fence":
        controller = Controller(scene.vehicle, point)
        controller.set_fence(scene.fence)
        return controller
    corners = waypoints(scene)
    if len(corners) < 2:
        return Controller(scene.vehicle, point)
    places = tuple(Place(north_m=n, east_m=e) for n, e in corners)
    path = Waypoints(waypoints=places, speed_mps=0.6 * characteristic_scales(scene.vehicle).speed_mps)
    return Controller(scene.vehicle, path, ControllerConfig())


def pid_commands(scene: Scene) -> Callable[[Estimate], Pair]:
    """Return the law of the PID rival: port and starboard thrust by line of sight to the next waypoint."""
    corners, vehicle = waypoints(scene), scene.vehicle
    p, scales = vehicle.coefficients(), characteristic_scales(vehicle)
    port, starboard = vehicle.thrusters[:2]
    w0 = 2.0 / scales.time_s

    def law(now: Estimate) -> Pair:
        here = np.array([now.north_m, now.east_m])
        while len(corners) > 1 and math.dist(here, corners[0]) < 0.5 * scales.length_m:
            corners.pop(0)
        off = np.array(corners[0]) - here
        wanted = off / scales.time_s
        limit = 0.6 * scales.speed_mps
        wanted *= min(1.0, limit / max(float(np.hypot(*wanted)), 1e-9))
        wanted -= np.array(scene.water)
        turn = math.remainder(math.atan2(wanted[1], wanted[0]) - now.heading_rad, 2.0 * math.pi)
        cos, sin = math.cos(now.heading_rad), math.sin(now.heading_rad)
        u_wanted = max(float(wanted[0] * cos + wanted[1] * sin), 0.0)
        u = (now.velocity_north_mps - scene.water[0]) * cos + (now.velocity_east_mps - scene.water[1]) * sin
        surge = 2.0 * w0 * p.mass_surge * (u_wanted - u)
        surge += (p.linear_surge + p.quadratic_surge * u_wanted) * u_wanted
        yaw = p.inertia_yaw * (w0 * w0 * turn - 2.0 * w0 * now.yaw_rate_radps)
        arms = p.arm_port + p.arm_starboard
        return (
            min(max((surge * p.arm_starboard + yaw) / arms, port.min_N), port.max_N),
            min(max((surge * p.arm_port - yaw) / arms, starboard.min_N), starboard.max_N),
        )

    return law


def fly(job: Job) -> Flown:
    """Fly one scene."""
    scene = scene_of(job.seed, moving=job.moving)
    vehicle, estimate = scene.vehicle, estimate_at_start(scene)
    assert vehicle.hull is not None
    hull_m, L = vehicle.hull.radius_m, characteristic_scales(vehicle).length_m
    controller = None if job.method == "pid" else controller_of(scene, job.method)
    law = pid_commands(scene)
    commands = SentCommands(vehicle)
    prediction = Prediction(vehicle)
    track, times, unsolved, cycles = [(estimate.north_m, estimate.east_m)], [0.0], 0, 0
    arrived = False
    while estimate.t_ns < scene.duration_s * 1e9 and not arrived:
        t_ns = estimate.t_ns
        if controller is None:
            plan = _plan_of(vehicle, t_ns, law(estimate), commands)
        else:
            if scene.obstacle is not None and job.method == "fence" and t_ns % REPORT_NS < CYCLE_NS:
                controller.add_obstacles(Obstacles(t_ns=t_ns, obstacles=(_reported(scene.obstacle, t_ns),)))
            plan = controller.plan(estimate)
            unsolved += plan.solve.status is not SolveStatus.SOLVED
        commands.add(plan)
        cycles += 1
        for part in (1, 2, 3):
            end = prediction.state_at(estimate, t_ns + part * CYCLE_NS // 3, commands)
            track.append((float(end.lateral[0]), float(end.lateral[1])))
            times.append((t_ns + part * CYCLE_NS // 3) * 1e-9)
        estimate = as_estimate(end, estimate)
        arrived = math.dist(track[-1], scene.goal) < L
    points = np.array(track)
    least, entered = _clearance(scene, points, np.array(times), hull_m)
    way_m = float(np.hypot(*np.diff(points, axis=0).T).sum())
    return Flown(least, entered, arrived, times[-1], way_m, unsolved, cycles)


def _reported(obstacle: Obstacle, t_ns: int) -> Obstacle:
    t = t_ns * 1e-9
    return msgspec.structs.replace(
        obstacle,
        t_ns=t_ns,
        north_m=obstacle.north_m + t * obstacle.velocity_north_mps,
        east_m=obstacle.east_m + t * obstacle.velocity_east_mps,
    )


def _plan_of(vehicle: Vehicle, t_ns: int, thrust: Pair, commands: SentCommands) -> Plan:
    """Return a plan that moves to a thrust at the slew limit."""
    before = commands.at(np.array([t_ns]))[0]
    slew = np.array([t.slew_N_per_s for t in vehicle.thrusters[:2]]) * CYCLE_NS * 1e-9
    after = before.copy()
    after[:2] = np.clip(thrust, before[:2] - slew, before[:2] + slew)
    return Plan(
        cycle_t_ns=t_ns,
        t_ns=np.array([t_ns, t_ns + CYCLE_NS]),
        thrust_N=np.array([before, after]),
        states=np.zeros((2, 6)),
        origin=PlanOrigin.MANUAL,
        solve=NOT_RUN,
    )


def _clearance(scene: Scene, points: Array, t_s: Array, hull_m: float) -> tuple[float, float]:
    """Return the least clearance of the hull, and the largest depth in a margin (m)."""
    least, entered = math.inf, 0.0
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


def table(found: dict[str, dict[str, Any]]) -> str:
    """Return the table of violations and arrivals by method."""
    lines = [
        "| scenes | method | flown | violated | largest violation (m) | entered a margin by 0.1 m | arrived | "
        "median time (s) | cycles unsolved |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for moving in (False, True):
        for method in METHODS:
            flown = [row for key, row in found.items() if key.startswith(f"{_kind(moving)} {method} ")]
            if not flown:
                continue
            least = np.array([row["clearance_m"] for row in flown])
            entered = np.array([row["entered_m"] for row in flown])
            arrived = np.array([row["arrived"] for row in flown])
            times = [row["duration_s"] for row in flown if row["arrived"]]
            unsolved, cycles = (sum(row[key] for row in flown) for key in ("unsolved", "cycles"))
            lines.append(
                f"| {_kind(moving)} | {method} | {len(flown)} | {(least < 0.0).sum()} | "
                f"{max(-float(least.min()), 0.0):.3f} | {(entered > 0.1).sum()} | {arrived.sum()} | "
                f"{np.median(times) if times else math.nan:.0f} | {unsolved} of {cycles} |"
            )
    return "\n".join(lines)


def _kind(moving: bool) -> str:
    return "moving" if moving else "zones"


def _key(job: Job) -> str:
    return f"{_kind(job.moving)} {job.method} {job.seed}"


def main() -> None:
    """Fly, keep, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--moving", type=int, default=300)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    jobs = [Job(seed, method, False) for seed in range(options.scenes) for method in options.methods]
    jobs += [Job(seed, method, True) for seed in range(options.moving) for method in options.methods]
    with open_store(options.out, {"benchmark": "fences"}) as store, Progress(console=Console(stderr=True)) as progress:
        missing = [job for job in jobs if _key(job) not in store.keys]
        task = progress.add_task("flights", total=len(jobs), completed=len(jobs) - len(missing))
        for place, flown in run_each(fly, missing, workers=options.workers):
            store.append(_key(missing[place]), flown._asdict())
            progress.advance(task)
        found = dict(store.results())
    print(table(found))


if __name__ == "__main__":
    main()
