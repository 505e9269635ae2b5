"""Warm-up of the controller: no function is left to be compiled after it."""

import subprocess
import sys

import pytest

from ltv_mpc.control.solvers import SOLVERS

SCRIPT = """
import sys
import msgspec, numpy as np
from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, PlanOrigin, Vehicle, advance, references
from ltv_mpc.control.solvers import make
from ltv_mpc.control.solvers.recorder import QpRecorder, RecordingSolver
from ltv_mpc.messages import Applied, CycleTiming, Solve, SolveStatus
from services.processes.controller import warm_up

(solver,) = sys.argv[1:]
vehicle, config = Vehicle.load("paper"), ControllerConfig(solver=solver)
reference = references.Hold(start_s=20.0, depth_m=30.0)

def compiled():
    return {
        (name, key): len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("ltv_mpc")
        for key, value in vars(module).items() if hasattr(value, "signatures")
    }

warm_up(vehicle, reference, config)
before = compiled()
fails = False
class Failing(RecordingSolver):
    def solve(self):
        if fails:
            raise RuntimeError("as asked")
        return super().solve()
controller = Controller(vehicle, reference, config, make_solver=lambda *settings: Failing(make(*settings)))
z = np.arange(40.0)
water = CurrentProfile(depth_m=z, north_mps=0.05 * np.sin(z), east_mps=0.05 * np.cos(z))
estimate = msgspec.structs.replace(Estimate.at_rest(depth_m=0.0), t_ns=15 * 10**9)
origins = set()
for k in range(60):
    plan = controller.plan(estimate)
    origins.add(plan.origin)
    estimate = msgspec.structs.replace(advance(vehicle, estimate, plan, duration_s=0.3), current=water)
    if k == 40:
        estimate = msgspec.structs.replace(estimate, north_m=4.0, heading_rad=2.0)
    thrust = tuple(plan.thrust_at(estimate.t_ns))
    controller.add_report(Applied(
        t_ns=estimate.t_ns, thrust_N=thrust, command_N=thrust, command_slew_N_per_s=(0.0, 0.0, 0.0), plan_epoch=1,
        plan_sequence=k, plan_cycle_t_ns=plan.cycle_t_ns, plan_received_t_ns=plan.cycle_t_ns + 10**7, plan_late=False,
        plans_late=0, plans_rejected=0))
    controller.add_timing(CycleTiming(
        t_ns=plan.cycle_t_ns, compute_ns=10**7, compute_wall_ns=10**7, estimate_age_ns=0, stage_us={}))
blind = msgspec.structs.replace(estimate, depth_m=None, velocity_down_mps=None, current=None)
controller.plan(blind)
controller.plan(msgspec.structs.replace(estimate, heading_rad=float("nan")))
for age_s in (2, 12, 25):
    origins.add(controller.plan(estimate, t_ns=estimate.t_ns + age_s * 10**9).origin)
controller.plan(estimate)
fails = True
for k in range(20):
    origins.add(controller.plan(estimate, t_ns=estimate.t_ns + k).origin)
assert set(PlanOrigin) - origins == {PlanOrigin.MANUAL}, origins
class Unsolved(RecordingSolver):
    def solve(self):
        return super().solve()._replace(solve=Solve(status=SolveStatus.FAILED))
recorder = QpRecorder(lambda *settings: Unsolved(make(*settings)))
unsolved = Controller(vehicle, references.Point(north_m=0.0, east_m=0.0), config, make_solver=recorder)
unsolved.plan(Estimate.at_rest(north_m=2.0, heading_rad=2.0))
assert recorder.failed is not None
after = compiled()
assert sum(before.values()) > 10
assert before == after, {key: (before.get(key), count) for key, count in after.items() if before.get(key) != count}
"""


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_function_is_compiled_after_the_warm_up(solver):
    """It runs in a separate process, where no other test has compiled anything."""
    ended = subprocess.run([sys.executable, "-P", "-c", SCRIPT, solver], capture_output=True, text=True, timeout=240)
    assert ended.returncode == 0, ended.stderr[-2000:]
