"""Rivals of the controller with a fence: hard rows; waypoints bent round the zones, without a fence and for PID."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np

from benchmarks.fences.scenes import Scene, settings_of
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.fallback import NOT_RUN
from ltv_mpc.control.ocp import limits
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.control.solvers.qpsolvers_backend import QpsolversBackend
from ltv_mpc.geofence.route import Router
from ltv_mpc.geofence.zones import pack_zones
from ltv_mpc.messages import Estimate, Pair, Plan, PlanOrigin
from ltv_mpc.references import Place, Point, Waypoints
from ltv_mpc.vehicle.parameters import Vehicle


def waypoints(scene: Scene) -> list[Pair]:
    """Return the corners of the shortest way round the grown zones, and the goal."""
    if scene.fence is None or scene.vehicle.hull is None:
        return [scene.goal]
    zones = pack_zones(scene.fence)
    way = Router(zones, scene.vehicle.hull.radius_m + zones.margin).way(np.zeros(2), np.array(scene.goal))
    return [(float(n), float(e)) for n, e in way]


class HardRows(QpsolversBackend):
    """PIQP on the QP with the rows of the fence, the last ones, as hard constraints."""

    def build(self, problem: Problem) -> None:
        """Take the problem with infinite penalties."""
        penalty = problem.penalty.copy()
        penalty[:, limits.ROWS :] = np.inf
        super().build(problem._replace(penalty=penalty))


def hard_controller(scene: Scene) -> Controller:
    """Return a controller with one QP a cycle, whose fence has hard rows."""
    settings = msgspec.structs.replace(settings_of(scene.name), solver="piqp", sqp_iterations=1)

    goal = Point(north_m=scene.goal[0], east_m=scene.goal[1])
    controller = Controller(scene.vehicle, goal, settings, make_solver=lambda _, config: HardRows(config))
    controller.set_fence(scene.fence)
    return controller


def bent_controller(scene: Scene) -> Controller:
    """Return a controller without a fence, whose reference is bent round the zones."""
    corners = waypoints(scene)
    if len(corners) < 2:
        return Controller(scene.vehicle, Point(north_m=scene.goal[0], east_m=scene.goal[1]), settings_of(scene.name))
    places = tuple(Place(north_m=n, east_m=e) for n, e in corners)
    path = Waypoints(waypoints=places, speed_mps=0.6 * characteristic_scales(scene.vehicle).speed_mps)
    return Controller(scene.vehicle, path, settings_of(scene.name))


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


def thrust_plan(vehicle: Vehicle, t_ns: int, period_ns: int, thrust: Pair, commands: SentCommands) -> Plan:
    """Return a plan of one period that moves to a thrust at the slew limit."""
    before = commands.at(np.array([t_ns]))[0]
    slew = np.array([t.slew_N_per_s for t in vehicle.thrusters[:2]]) * period_ns * 1e-9
    after = before.copy()
    after[:2] = np.clip(thrust, before[:2] - slew, before[:2] + slew)
    return Plan(
        cycle_t_ns=t_ns,
        t_ns=np.array([t_ns, t_ns + period_ns]),
        thrust_N=np.array([before, after]),
        states=np.zeros((2, 6)),
        origin=PlanOrigin.MANUAL,
        solve=NOT_RUN,
    )
