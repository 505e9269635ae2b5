"""Closed loop without messages, sensors or recording: true vehicle, controller, and the figures of both.

The instants of a run in lock step with ``run.perfect_state``: a cycle each 0.3 s on the truth of that instant, the
plant in steps of 10 ms. Its figures are those of ``ltv-mpc sim --lockstep`` to 1e-3 m, in a fraction of the time, and
a study can put its hands in: what the controller is told of the water, a thruster that is weaker than it says, another
controller.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ltv_mpc.control.controller import Controller
from ltv_mpc.frames import wrap_angle
from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate, Pair, Plan, Times
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.propulsion import propulsive_power_W
from services.run.run_config import Override, RunConfig, resolve
from sim import motion
from sim.plant import level_to_ned
from sim.water import WaterColumn

STEP_NS = 10_000_000
"""Step of the true vehicle, as in the plant."""

SIDES = ("min_N", "max_N")

Told = Callable[[Estimate], Estimate]
"""Function that returns the controller's estimate for a true one."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One run from t = 0 on, sampled each 10 ms."""

    distance_m: Array  # (K,) truth to reference
    commands_N: Array  # (K, 2) port, starboard
    mean_abs_N: float  # commands, over time and both lateral thrusters
    saturated: float  # fraction of the time with either of them at its minimum or maximum
    origins: dict[str, int]  # plans by where they came from
    lateral_energy_J: float  # at the propellers of port and starboard, all of the run

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        tracks: Sequence[Array],
        commands: Sequence[Array],
        target_m: Pair,
        origins: dict[str, int] | None = None,
        *,
        lateral_energy_J: float = float("nan"),
    ) -> Outcome:
        """Return the outcome of positions (M, 2) and commands (M, 2), given in pieces."""
        off, F = np.concatenate(tracks) - np.array(target_m), np.concatenate(commands)
        low, high = (np.array([getattr(t, side) for t in vehicle.thrusters[:2]]) for side in SIDES)
        at_box = ((low + 1e-6 >= F) | (high - 1e-6 <= F)).any(axis=1)
        return cls(np.hypot(*off.T), F, float(np.abs(F).mean()), float(at_box.mean()), origins or {}, lateral_energy_J)

    @property
    def mean_m(self) -> float:
        """Mean distance."""
        return float(self.distance_m.mean())

    @property
    def max_m(self) -> float:
        """Largest distance."""
        return float(self.distance_m.max())


@dataclass(kw_only=True)
class Loop:
    """One situation, flown by one controller.

    ``share`` (3,): of what they report, the part that port, starboard and vertical thruster really deliver.
    ``compensates`` false: the controller is told that its plans are there at once, and each comes in its delay later.
    ``at_rest`` true: the vehicle begins at rest over ground; else it moves with the water.
    """

    run_config: RunConfig
    controller: Controller
    told: Told = lambda estimate: estimate
    seen: Callable[[Estimate, Plan], None] = lambda _estimate, _plan: None
    share: Array = field(default_factory=lambda: np.ones(3))
    compensates: bool = True
    at_rest: bool = False

    def fly(self) -> Outcome:
        """Make the whole run. ``seen`` receives each cycle's estimate and plan after t = 0."""
        scenario, water, controller = self.run_config.scenario, self.run_config.water, self.controller
        plant = TrueVehicle(self.run_config, self.share)
        if self.at_rest:
            plant.stop(scenario.start_ns)
        depths = told_depths(self.run_config)
        period_ns, delay_ns = scenario.controller.period_ns, round(scenario.run.compute_delay_s * 1e9)
        told_ns = delay_ns if self.compensates else 0
        late_ns = delay_ns - told_ns
        t_ns, next_ns = scenario.start_ns, -(-scenario.start_ns // period_ns) * period_ns
        plans: list[Plan] = []
        states, commands = [], []
        while t_ns < scenario.end_ns:
            until_ns = min(next_ns, scenario.end_ns)
            times = np.append(np.arange(t_ns, until_ns, STEP_NS), until_ns)
            # Plans arrive when they were expected to: what was sent is what is in force.
            u = np.where(times[:, None] >= 0, controller.sent_commands.at(times - late_ns), 0.0)
            track = plant.go(times, u)
            if t_ns >= 0:
                states.append(track)
                commands.append(u[1:, :2])
            t_ns = until_ns
            if t_ns >= scenario.end_ns:
                break
            controller.add_report(_applied(t_ns, plant.thrust / self.share, u[-1], plans, told_ns))
            estimate = self.told(known(t_ns, plant.state, water, depths))
            plans.append(controller.plan(estimate, t_ns=t_ns))
            next_ns = t_ns + max(period_ns, delay_ns)
            if plans[-1].reference_m is not None:
                self.seen(estimate, plans[-1])
        origins = Counter(plan.origin.value for plan in plans if plan.reference_m is not None)
        target_m = plans[-1].reference_m
        assert target_m is not None  # it has begun
        energy_J = plant.lateral_energy_J
        return Outcome.of(controller.vehicle, states, commands, target_m, dict(origins), lateral_energy_J=energy_J)


class TrueVehicle:
    """True vehicle: the motion of the plant, without its node and its gate."""

    def __init__(self, run_config: RunConfig, share: Array) -> None:
        start, vehicle = run_config.scenario.plant, run_config.vehicle
        self.state = np.array([start.north_m, start.east_m, 0.0, 0.0, start.heading_rad, 0.0, start.depth_m, 0.0])
        self.thrust = np.zeros(3)
        self._revolutions = np.zeros(3)
        self._share = share
        self._water = run_config.water
        self._vehicle = vehicle
        self.lateral_energy_J = 0.0
        """Propulsive energy of port and starboard so far, by the power at the end of each call of ``go``."""
        self._body = motion.pack(vehicle, start.mismatch)

    def stop(self, t_ns: int) -> None:
        """Set the velocity over ground to zero."""
        north, east = self._water.at(self.state[6], t_ns)
        cos, sin = np.cos(self.state[4]), np.sin(self.state[4])
        # [u, v] = R(psi)' (0 - c)
        self.state[2:4] = -cos * north - sin * east, sin * north - cos * east

    def go(self, t_ns: Times, u: Array) -> Array:
        """Simulate under commands u (M+1, 3) at t_ns (M+1,); return the positions (M, 2) after each step."""
        vehicle = motion.MotionState(self.state, self._revolutions, self.thrust)
        water = self._water.sample(int(t_ns[0] + t_ns[-1]) // 2)
        track: Array = motion.simulate(self._body, vehicle, t_ns * 1e-9, u * self._share, water)
        power = propulsive_power_W(self._vehicle, self.thrust[None], self.state[2:3], self.state[7:8])
        lateral_W = float("nan") if power is None else float(power[0, :2].sum())
        self.lateral_energy_J += lateral_W * float(t_ns[-1] - t_ns[0]) * 1e-9
        return track


def _applied(t_ns: int, thrust: Array, command: Array, plans: Sequence[Plan], delay_ns: int) -> Applied:
    """Return the actuators' report if the last plan came ``delay_ns`` after the start of its cycle."""
    cycle_ns = plans[-1].cycle_t_ns if plans else 0
    return Applied(
        t_ns=t_ns,
        thrust_N=tuple(thrust.tolist()),
        command_N=tuple(command.tolist()),
        command_slew_N_per_s=(0.0, 0.0, 0.0),
        plan_epoch=1 if plans else 0,
        plan_sequence=len(plans) - 1,
        plan_cycle_t_ns=cycle_ns,
        plan_received_t_ns=cycle_ns + delay_ns,
        plan_late=False,
        plans_late=0,
        plans_rejected=0,
    )


def told_depths(of: RunConfig) -> Array:
    """Return the depths (m) of an estimate's profile."""
    estimator = of.scenario.estimator
    return estimator.cell_m * np.arange(round(estimator.deepest_m / estimator.cell_m) + 1, dtype=np.float64)


def known(t_ns: int, state: Array, water: WaterColumn, depths_m: Array) -> Estimate:
    """Return the true state as an estimate, with the whole current at ``depths_m`` (K,)."""
    n, e, u, v, psi, r, z, w = state.tolist()
    here, current = water.at(z, t_ns), water.over(depths_m, t_ns)
    # [n', e'] = R(psi) [u, v] + c(z)
    north, east = level_to_ned(u, v, psi)
    return Estimate(
        t_ns=t_ns,
        north_m=n,
        east_m=e,
        heading_rad=wrap_angle(psi),
        yaw_rate_radps=r,
        velocity_north_mps=north + here[0],
        velocity_east_mps=east + here[1],
        depth_m=z,
        velocity_down_mps=w,
        current=CurrentProfile(
            depth_m=depths_m,
            north_mps=np.ascontiguousarray(current[:, 0]),
            east_mps=np.ascontiguousarray(current[:, 1]),
            sd_mps=np.zeros(len(depths_m)),
        ),
    )


def run_config(*settings: str, scenario: str = "descent") -> RunConfig:
    """Resolve a shipped scenario with KEY=VALUE settings on top and the state known."""
    return resolve(scenario, [Override("benchmark", ("run.perfect_state=true", *settings))])
