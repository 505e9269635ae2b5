"""Identification against a known truth: how often the 95 % intervals hold it, and how wide they are.

Each run is a closed loop of 120 s: the controller drives the paper's vehicle, as its file says, to the corners
of a square of 3 m, 15 s each, in a random steady current of up to 0.3 m/s that the estimates do not contain. The true
vehicle has mass, drag and thrust of 0.7 to 1.3 times the file's, each random, and the simulation's own propellers.
The estimates that are identified are those of a point of up to 0.5 m forward and starboard of the origin, each random,
which the file does not give. Estimates come at 10 Hz with white errors of 5 mm/s north and east, 2 mrad/s, 5 mrad; the
reports of the actuators have 0.1 N.

    python -m benchmarks.identification [--runs 50] [--known thrust|mass] [--known-yaw arm|inertia] [--current-known]
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections import defaultdict

import msgspec
import numpy as np

from ltv_mpc import references
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.messages import Array, CurrentProfile, Estimate
from ltv_mpc.vehicle.flow import advance_stage, lag_table
from ltv_mpc.vehicle.identification import Identification, identify
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from ltv_mpc.vehicle.shooting_fit import REFERENCE_POINT, Motion, theta_scale
from sim import motion
from sim.motion import apply_mismatch
from sim.plant import level_to_ned
from sim.scenario import Mismatch
from sim.water.column import WaterSample

STEP_NS = 10_000_000
CYCLE_NS, ESTIMATE_NS = 300_000_000, 100_000_000
DURATION_S, CORNER_S, SIDE_M = 120, 15.0, 3.0
SD_MPS, SD_RADPS, SD_RAD, SD_N = 0.005, 0.002, 0.005, 0.1
FASTEST_MPS = 0.3


class _Boat:
    """True vehicle in a steady current, and its estimates."""

    def __init__(
        self, vehicle: Vehicle, mismatch: Mismatch, current: Array, actuators: str, rng: np.random.Generator
    ) -> None:
        self._p, self._factor = apply_mismatch(vehicle.coefficients(), mismatch), mismatch.thrust
        self._body = motion.pack(vehicle, mismatch)
        self._model = actuators == "model"
        self._current, self._rng = current, rng
        self._state, self._revolutions, self._thrust = np.zeros(8), np.zeros(3), np.zeros(3)
        profile = np.tile(current, (2, 1))
        self._water = WaterSample(np.array([0.0, 50.0]), profile, profile, 0.0)

    def go(self, u0: Array, u1: Array) -> None:
        """Take one step under commands from ``u0`` to ``u1`` (3,)."""
        if self._model:
            self._follow(u0[:2], u1[:2])
            return
        vehicle = motion.MotionState(self._state, self._revolutions, self._thrust)
        motion.step(self._body, vehicle, u0, u1, False, STEP_NS * 1e-9, self._water)

    def _follow(self, u0: Array, u1: Array) -> None:
        """Integrate one step with the thruster lag of the controller's model."""
        X, out = np.concatenate([self._state[:6], self._factor * self._thrust[:2]]), np.empty(8)
        c, k = self._current, self._factor
        advance_stage(X, k * u0, k * u1, c, c, STEP_NS * 1e-9, self._p, lag_table(STEP_NS * 1e-9, self._p), out)
        self._state[:6], self._thrust[:2] = out[:6], out[6:] / k

    @property
    def reported_N(self) -> Array:
        """Delivered thrust (2,) as the actuators report it: without the factor that they do not know of."""
        return self._thrust[:2] + SD_N * self._rng.standard_normal(2)

    def estimate(self, t_ns: int, *, with_current: bool) -> Estimate:
        """Return the true state as an estimate with errors, with or without the current."""
        n, e, u, v, psi, r, _, _ = self._state.tolist()
        north, east = level_to_ned(u, v, psi) + self._current
        draws = self._rng.standard_normal(4)
        one = np.ones(1)
        return Estimate(
            t_ns=t_ns,
            north_m=n,
            east_m=e,
            heading_rad=math.remainder(psi + SD_RAD * draws[3], 2.0 * math.pi),
            yaw_rate_radps=r + SD_RADPS * draws[2],
            velocity_north_mps=north + SD_MPS * draws[0],
            velocity_east_mps=east + SD_MPS * draws[1],
            current=CurrentProfile(depth_m=0.0 * one, north_mps=self._current[0] * one, east_mps=self._current[1] * one)
            if with_current
            else None,
        )


def recorded(
    vehicle: Vehicle,
    mismatch: Mismatch,
    seed: int,
    *,
    actuators: str = "propellers",
    reports: bool = True,
    current_known: bool = False,
    point_m: tuple[float, float] = (0.0, 0.0),
) -> Motion:
    """Return the motion of one run at ``point_m``, with or without the actuators' reports and the current."""
    rng = np.random.default_rng(seed)
    speed, towards = rng.uniform(0.0, FASTEST_MPS), rng.uniform(-np.pi, np.pi)
    boat = _Boat(vehicle, mismatch, speed * np.array([np.cos(towards), np.sin(towards)]), actuators, rng)
    controller, commands = Controller(vehicle, _corner(0)), SentCommands(vehicle)
    seen: list[tuple[float, list[float], float, Array, Array]] = []
    for t_ns in range(0, round(DURATION_S * 1e9), ESTIMATE_NS):
        estimate = boat.estimate(t_ns, with_current=current_known)
        seen.append(_relative(estimate, commands.at(np.array([t_ns]))[0, :2], boat.reported_N))
        if t_ns % round(CORNER_S * 1e9) == 0:
            controller.follow(_corner(t_ns // round(CORNER_S * 1e9)))
        if t_ns % CYCLE_NS == 0:
            commands.add(controller.plan(estimate))
        steps = commands.at(np.arange(t_ns, t_ns + ESTIMATE_NS + 1, STEP_NS))
        for before, after in itertools.pairwise(steps):
            boat.go(before, after)
    t, of_origin, heading, command, thrust = zip(*seen, strict=True)
    velocity, (forward, starboard) = np.array(of_origin), point_m
    velocity[:, :2] += np.outer(velocity[:, 2], (-starboard, forward))
    return Motion(
        t_s=np.array(t),
        velocity=velocity,
        heading=np.array(heading),
        shear=np.zeros((len(t), 2)),
        command=np.array(command),
        sd=np.array([SD_MPS, SD_MPS, SD_RADPS]),
        thrust=np.array(thrust) if reports else None,
    )


def _corner(count: int) -> references.Point:
    north, east = ((0, 0), (1, 0), (1, 1), (0, 1))[count % 4]
    return references.Point(north_m=SIDE_M * north, east_m=SIDE_M * east)


def _relative(estimate: Estimate, command: Array, thrust: Array) -> tuple[float, list[float], float, Array, Array]:
    north, east = estimate.velocity_north_mps, estimate.velocity_east_mps
    if estimate.current is not None:
        north, east = north - estimate.current.north_mps[0], east - estimate.current.east_mps[0]
    cos, sin = math.cos(estimate.heading_rad), math.sin(estimate.heading_rad)
    velocity = [cos * north + sin * east, cos * east - sin * north, estimate.yaw_rate_radps]
    return estimate.t_ns * 1e-9, velocity, estimate.heading_rad, command, thrust


def truth(vehicle: Vehicle, mismatch: Mismatch, known: str, known_yaw: str) -> dict[str, float]:
    """Return the true coefficients by name, in the file's units, if one scale is taken from the file."""
    true, file = apply_mismatch(vehicle.coefficients(), mismatch), vehicle.coefficients()
    # All forces over the scale that is taken as known: the motion is the same.
    scale = mismatch.thrust if known == "thrust" else mismatch.mass
    yaw = mismatch.thrust if known_yaw == "arm" else mismatch.mass
    values = {name: value / (yaw if name.endswith("yaw") else scale) for name, value in true._asdict().items()}
    values |= {name: getattr(file, name) for name in Coefficients._fields if name.startswith("lag")}
    arm = mismatch.thrust / (mismatch.thrust / scale) / yaw if known_yaw == "inertia" else 1.0
    values |= {name: getattr(file, name) * arm for name in ("arm_port", "arm_starboard")}
    return values | {"thrust": mismatch.thrust / scale}


def held(found: Identification, true: dict[str, float], unit: dict[str, float]) -> dict[str, tuple[bool, float, bool]]:
    """Return by name if the interval holds the truth, its half width over ``unit``, and whether it is reported."""
    return {
        one.name: (
            one.low <= true[one.name] <= one.high,
            0.5 * (one.high - one.low) / unit[one.name],
            one.excited,
        )
        for one in found.coefficients
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--known", choices=("thrust", "mass"), default="thrust")
    parser.add_argument("--known-yaw", choices=("arm", "inertia"), default="arm")
    parser.add_argument("--no-reports", action="store_true", help="no actuators' reports: the plans alone")
    parser.add_argument("--current-known", action="store_true", help="the estimates contain the current")
    parser.add_argument("--actuators", choices=("propellers", "model"), default="propellers")
    options = parser.parse_args()
    vehicle = Vehicle.load("paper")
    unit = dict(zip((*Coefficients._fields, "thrust", *REFERENCE_POINT), theta_scale(vehicle).tolist(), strict=True))
    rows: dict[str, list[tuple[bool, float, bool]]] = defaultdict(list)
    for seed in range(options.first_seed, options.first_seed + options.runs):
        factors = np.random.default_rng([seed, 1]).uniform(0.7, 1.3, 3)
        point_m = tuple(np.random.default_rng([seed, 2]).uniform(-0.5, 0.5, 2).tolist())
        mismatch = msgspec.convert(dict(zip(("mass", "drag", "thrust"), factors.tolist(), strict=True)), Mismatch)
        found = identify(
            vehicle,
            recorded(
                vehicle,
                mismatch,
                seed,
                actuators=options.actuators,
                reports=not options.no_reports,
                current_known=options.current_known,
                point_m=point_m,
            ),
            options.known,
            options.known_yaw,
        )
        true = truth(vehicle, mismatch, options.known, options.known_yaw)
        true |= dict(zip(REFERENCE_POINT, point_m, strict=True))
        for name, one in held(found, true, unit).items():
            rows[name].append(one)
        print(
            f"run {seed}: {sum(every[-1][0] for every in rows.values())} of {len(rows)} held",
            file=sys.stderr,
            flush=True,
        )
    print(f"{options.runs} runs of {DURATION_S} s; {options.known} and {options.known_yaw} taken from the file")
    print(f"{'':<18}{'held':>6}{'half width':>12}{'excited':>9}")
    for name, every in rows.items():
        inside, width, excited = (np.array(column) for column in zip(*every, strict=True))
        print(f"{name:<18}{inside.mean():6.0%}{np.median(width):12.1%}{excited.mean():9.0%}")


if __name__ == "__main__":
    main()
