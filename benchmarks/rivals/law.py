"""Feedback law in the loop of ``benchmarks/loop.py``: same vehicle, water and instants, without a plan.

A law is asked ten times a second for port and starboard thrust; the actuators bring the command there within box and
slew, as the gate does with a plan. It computes in no time. The vertical thruster is at its maximum from t = 0 on, which
is what a descent at 0.2 m/s takes.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from benchmarks.loop import STEP_NS, Outcome, TrueVehicle, known, told_depths
from ltv_mpc.messages import Array, Estimate, Pair
from services.run.run_config import RunConfig

PERIOD_NS = 100_000_000


class Law(Protocol):
    """Feedback for one run: it may remember."""

    def thrust(self, estimate: Estimate, target_m: Pair) -> Pair:
        """Port and starboard (N) for the next tenth of a second; beyond the box it is cut off."""
        ...


def fly(run_config: RunConfig, law: Law) -> Outcome:
    """Make the whole run; the target is the vehicle's position at t = 0."""
    scenario, water, vehicle = run_config.scenario, run_config.water, run_config.vehicle
    plant = TrueVehicle(run_config, np.ones(3))
    depths = told_depths(run_config)
    low, high, slew = (
        np.array([getattr(t, name) for t in vehicle.thrusters]) for name in ("min_N", "max_N", "slew_N_per_s")
    )
    command = np.zeros(3)
    target: Pair | None = None
    states, commands = [], []
    for t_ns in range(scenario.start_ns, scenario.end_ns, PERIOD_NS):
        wanted = np.zeros(3)
        if t_ns >= 0:
            estimate = known(t_ns, plant.state, water, depths)
            target = target or (estimate.north_m, estimate.east_m)
            wanted = np.array([*law.thrust(estimate, target), high[2]]).clip(low, high)
        times = np.arange(t_ns, min(t_ns + PERIOD_NS, scenario.end_ns) + 1, STEP_NS)
        u = ramped(command, wanted, slew, (times - t_ns) * 1e-9)
        track = plant.go(times, u)
        command = u[-1]
        if t_ns >= 0:
            states.append(track)
            commands.append(u[1:, :2])
    assert target is not None  # a run goes beyond t = 0
    return Outcome.of(vehicle, states, commands, target, lateral_energy_J=plant.lateral_energy_J)


def ramped(command: Array, wanted: Array, slew: Array, since_s: Array) -> Array:
    """Return commands (M, 3) at ``since_s`` (M,) after ``command`` (3,) towards ``wanted`` at no more than ``slew``."""
    reach = since_s[:, None] * slew
    out: Array = command + (wanted - command).clip(-reach, reach)
    return out


class Nothing:
    """No thrust at all."""

    def thrust(self, estimate: Estimate, target_m: Pair) -> Pair:  # noqa: ARG002
        """None."""
        return 0.0, 0.0
