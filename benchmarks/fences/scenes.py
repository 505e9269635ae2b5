"""Random scenes: a vehicle, zones or a crossing obstacle, a current, and a point at the far end of a lane."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.config import ControllerConfig, ResolvedConfig
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.geofence.fence import Disc, Fence, Polygon
from ltv_mpc.messages import CurrentProfile, Estimate, Obstacle, Pair
from ltv_mpc.references import Place
from ltv_mpc.vehicle.parameters import Hull, Vehicle
from ltv_mpc.vehicle.performance import Performance, performance
from tests.foreign_plant.flight import HULL

VEHICLES = ("paper", "low-yaw", "surface", "weak-reverse", "foreign")
GAP_FACTOR = 1.5


class Scene(NamedTuple):
    """One scene."""

    name: str  # of the vehicle
    vehicle: Vehicle
    fence: Fence | None
    obstacle: Obstacle | None
    goal: Pair
    water: Pair
    heading_rad: float
    duration_s: float


@lru_cache
def vehicle_of(name: str) -> tuple[Vehicle, Performance]:
    """Return a vehicle and its performance; its hull is half its length scale if the file has none."""
    vehicle = Vehicle.load(str(HULL) if name == "foreign" else name)
    if vehicle.hull is None:
        length = 0.3 * characteristic_scales(vehicle).length_m
        vehicle = msgspec.structs.replace(vehicle, hull=Hull(length_m=length, beam_m=0.4 * length))
    return vehicle, performance(vehicle)


@lru_cache
def settings_of(name: str) -> ResolvedConfig:
    """Return the default settings of a vehicle's controller."""
    return settled(ControllerConfig(), vehicle_of(name)[0])


def scene_of(seed: int, *, moving: bool) -> Scene:
    """Draw a scene."""
    rng = np.random.default_rng([31, seed, int(moving)])
    name = VEHICLES[rng.integers(len(VEHICLES))]
    vehicle, can = vehicle_of(name)
    assert vehicle.hull is not None
    scales = characteristic_scales(vehicle)
    speed = rng.uniform(0.0, 0.5) * scales.speed_mps
    angle = rng.uniform(-math.pi, math.pi)
    water = speed * math.cos(angle), speed * math.sin(angle)
    L = scales.length_m
    margin = 0.15 * L
    needed = 2.0 * vehicle.hull.radius_m + 2.0 * margin + speed * (can.turn_90deg_s or 0.0)
    gap, size = GAP_FACTOR * needed, max(L, 0.5 * needed)
    count = 0 if moving else int(rng.integers(1, 9))
    lane = 6.0 * size + 3.0 * gap
    fence = _fence(rng, count, margin, gap, size, lane)
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
    duration_s = 4.0 * lane / (0.5 * scales.speed_mps) + 20.0 * (can.turn_90deg_s or 1.0)
    return Scene(name, vehicle, fence, obstacle, (lane, 0.0), water, heading, duration_s)


def _fence(rng: np.random.Generator, count: int, margin: float, gap: float, size: float, lane: float) -> Fence | None:
    """Draw up to ``count`` discs and convex polygons in a lane, with a gap between them and round its ends."""
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
    return Fence(margin_m=margin, keep_out=tuple(polygons), keep_out_disc=tuple(discs)) if places else None


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


def obstacle_at(obstacle: Obstacle, t_ns: int) -> Obstacle:
    """Return the report of an obstacle at a later time."""
    t = t_ns * 1e-9
    return msgspec.structs.replace(
        obstacle,
        t_ns=t_ns,
        north_m=obstacle.north_m + t * obstacle.velocity_north_mps,
        east_m=obstacle.east_m + t * obstacle.velocity_east_mps,
    )
