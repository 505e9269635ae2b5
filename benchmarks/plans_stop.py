"""Drift when plans stop: the controller dies, the link is lost, the controller is restarted.

    .venv/bin/python -m benchmarks.plans_stop [--seeds N] [--vehicle NAME|FILE ...]

The true vehicle behind the plan gate holds a point, or drives along a line of 40 m, in a steady current of 0.35 of its
top speed that is told with an error of 0.03 of the top speed. At 25 s (hold) or 15 s (line) plans stop: for good
(dies), for 10 s (link), or until a new controller continues 3 or 8 s later from the state of the old one (restart).
Each seed is flown twice: following plans to their last knot, as before, and with the vehicle's ``plan_timeout_s``.

    rest    time from the last plan until both lateral thrusters are at rest (s)
    way     distance moved through the water from the last plan on, until all is over (m), 40 s
    off     largest distance from the point or the line in this time (m)
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.loop import STEP_NS, TrueVehicle, known, run_config, told_depths
from benchmarks.vehicles import afloat
from ltv_mpc import references
from ltv_mpc.control.controller import SAVE_PERIOD_NS, Controller
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.messages import Applied, Array, ControllerState, CurrentProfile, Estimate, Plan
from ltv_mpc.safety.plan_gate import PlanGate
from ltv_mpc.vehicle.parameters import Vehicle
from sim.water.column import WaterColumn

S = 1_000_000_000
PERIOD_NS, DELAY_NS = 300_000_000, 50_000_000
AFTER_NS = 40 * S
CURRENT, TOLD_WRONG = 0.35, 0.03
"""Current, and the error of the told one, over the top speed."""

SHIPPED = ("paper", "surface", "low-yaw", "weak-reverse")
STOPS = {"hold": 25 * S, "line": 15 * S}
SILENCE_NS = {"dies": AFTER_NS, "link 10 s": 10 * S, "restart 3 s": 3 * S, "restart 8 s": 8 * S}
TO_THE_LAST_KNOT_S = 60.0


class Drift(NamedTuple):
    """Figures of one run from the last plan on."""

    rest_s: float  # infinite if the thrusters are never at rest
    way_m: float
    off_m: float
    off: Array  # (K,) distance from point or line each 10 ms (m)


def fly(vehicle: Vehicle, place: str, event: str, seed: int) -> Drift:
    """Make one run."""
    rng = np.random.default_rng(seed)
    top = characteristic_scales(vehicle).speed_mps
    towards, wrong, heading = rng.uniform(-np.pi, np.pi, 3)
    current = CURRENT * top * np.array([np.cos(towards), np.sin(towards)])
    error = TOLD_WRONG * top * np.array([np.cos(wrong), np.sin(wrong)])
    line = msgspec.structs.replace(references.load("line"), speed_mps=0.5 * top, depth_m=None)
    reference = references.Point(north_m=0.0, east_m=0.0) if place == "hold" else line
    base = run_config(f"plant.heading_rad={heading if place == 'hold' else 0.3 * heading}")
    water = WaterColumn(np.array([0.0, 50.0]), np.tile(current, (2, 1)))
    run = replace(base, vehicle=vehicle, water=water, reference=reference)
    true, gate, depths = TrueVehicle(run, np.ones(3)), PlanGate(vehicle), told_depths(run)

    def estimate(t_ns: int) -> Estimate:
        told = afloat(known(t_ns, true.state, water, depths))
        assert isinstance(told.current, CurrentProfile)
        off = msgspec.structs.replace(
            told.current, north_mps=told.current.north_mps + error[0], east_mps=told.current.east_mps + error[1]
        )
        return msgspec.structs.replace(told, current=off)

    def new_controller() -> Controller:
        return Controller(vehicle, reference, run.scenario.controller)

    controller, state, newest, received_ns = new_controller(), ControllerState(t_ns=0), None, 0
    stop_ns = STOPS[place]
    again_ns = stop_ns + SILENCE_NS[event]
    y, commands, tracks, way = np.zeros(3), [], [], []
    for cycle, t_ns in enumerate(range(0, stop_ns + AFTER_NS, PERIOD_NS)):
        silent = stop_ns <= t_ns < again_ns
        if event.startswith("restart") and silent:
            controller = None
        elif event.startswith("restart") and controller is None:
            controller = new_controller()
            controller.restore(msgspec.structs.replace(state, plan=newest), t_ns)
        plan = None
        if controller is not None and not (silent and event == "dies"):
            controller.add_report(_report(t_ns, true.thrust, y, newest, cycle, received_ns))
            plan = controller.plan(estimate(t_ns), t_ns=t_ns)
            if t_ns - state.t_ns >= SAVE_PERIOD_NS:
                state = controller.save(t_ns)
        for from_ns, until_ns in ((t_ns, t_ns + DELAY_NS), (t_ns + DELAY_NS, t_ns + PERIOD_NS)):
            times = np.arange(from_ns, until_ns + 1, STEP_NS)
            if from_ns != t_ns and plan is not None and not silent:
                gate.offer(plan, 1 if t_ns < again_ns else 2, cycle, from_ns)
                newest, received_ns = plan, from_ns
            u = np.vstack([y, gate.commands_at(times[1:].tolist())])
            tracks.append(true.go(times, u))
            commands.append(u[1:, :2])
            way.append(np.full(len(u) - 1, np.hypot(*true.state[2:4]) * STEP_NS * 1e-9))
            y = u[-1]
    begin = (stop_ns - PERIOD_NS + DELAY_NS) // STEP_NS  # the last plan arrives
    F, x, moved = (np.concatenate(pieces)[begin:] for pieces in (commands, tracks, way))
    at_rest = np.flatnonzero((np.abs(F) < 0.01).all(axis=1))
    off = np.hypot(x[:, 0], x[:, 1]) if place == "hold" else np.abs(x[:, 1])
    return Drift(0.01 * at_rest[0] if len(at_rest) else np.inf, float(moved.sum()), float(off.max()), off)


def _report(t_ns: int, thrust: Array, command: Array, plan: Plan | None, sequence: int, received_ns: int) -> Applied:
    return Applied(
        t_ns=t_ns,
        thrust_N=tuple(thrust.tolist()),
        command_N=tuple(command.tolist()),
        command_slew_N_per_s=(0.0, 0.0, 0.0),
        plan_epoch=1,
        plan_sequence=-1 if plan is None else sequence,
        plan_cycle_t_ns=0 if plan is None else plan.cycle_t_ns,
        plan_received_t_ns=received_ns,
        plan_late=False,
        plans_late=0,
        plans_rejected=0,
    )


def pairs(names: list[str], seeds: int) -> Iterator[tuple[str, str, str, list[Drift], list[Drift]]]:
    """Return vehicle, place, event, and the runs before and after."""
    for name in names:
        after = Vehicle.load(name)
        before = msgspec.structs.replace(after, plan_timeout_s=TO_THE_LAST_KNOT_S)
        for place in STOPS:
            for event in SILENCE_NS:
                runs = [[fly(v, place, event, seed) for seed in range(seeds)] for v in (before, after)]
                yield after.name, place, event, runs[0], runs[1]


def main() -> None:
    """Print the table, and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicle", nargs="*", default=[*SHIPPED])
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args()
    print("mean, and the worst, before -> after")
    for name, place, event, before, after in pairs(options.vehicle, options.seeds):
        cells = []
        for i, unit in enumerate(Drift._fields[:3]):
            b, a = ([run[i] for run in runs] for runs in (before, after))
            cells.append(f"{unit} {np.mean(b):6.2f} {max(b):6.2f} -> {np.mean(a):6.2f} {max(a):6.2f}")
        print(f"{name:<13}{place:<6}{event:<12}" + "   ".join(cells), flush=True)


if __name__ == "__main__":
    main()
