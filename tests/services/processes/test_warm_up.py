"""Warm-up of controller and estimator: no function is left to be compiled after it."""

import subprocess
import sys

import pytest

from ltv_mpc.control.solvers import SOLVERS

HEAD = """
import sys
import msgspec, numpy as np

def compiled():
    return {
        (name, key): len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("ltv_mpc")
        for key, value in vars(module).items() if isinstance(getattr(value, "signatures", None), list)
    }
"""

CONTROLLER = """
from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, PlanOrigin, Vehicle, advance, references
from ltv_mpc.control.solvers import make
from ltv_mpc.control.solvers.recorder import QpRecorder, RecordingSolver
from ltv_mpc.messages import Applied, CycleTiming, Solve, SolveStatus
from services.processes.controller import warm_up

vehicle, config = Vehicle.load("paper"), ControllerConfig(solver=kind)
reference = references.Hold(start_s=20.0, depth_m=30.0)

warm_up(vehicle, reference, config)
before = compiled()
fails = False
class Failing(RecordingSolver):
    def solve(self, *problem, last=True):
        if fails:
            raise RuntimeError("as asked")
        return super().solve(*problem, last=last)
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
    def solve(self, *problem, last=True):
        return super().solve(*problem, last=last)._replace(solve=Solve(status=SolveStatus.FAILED))
recorder = QpRecorder(lambda *settings: Unsolved(make(*settings)))
unsolved = Controller(vehicle, references.Point(north_m=0.0, east_m=0.0), config, make_solver=recorder)
unsolved.plan(Estimate.at_rest(north_m=2.0, heading_rad=2.0))
assert recorder.failed is not None
"""

ESTIMATOR = """
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensors.bottom_track import BottomTracking
from ltv_mpc.localisation.sensors.lbl import Lbl
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.usbl import Usbl
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.messages import *
from tests.stepping import as_sent
from services.processes.estimator import warm_up

odd = {"period_ns": 10**9, "missing_share": 0.0, "outlier_share": 0.0, "outlier_m": 0.0}
base = SensorConfig.load("realistic")
full = msgspec.structs.replace(
    base,
    gnss=msgspec.structs.replace(base.gnss, lever_arm_m=(1.0, 0.0, -2.0)),
    lbl=Lbl(**odd, transponders_m=((50.0, 0.0, 40.0),), sound_speed_mps=1500.0, sound_speed_sd_mps=2.0, range_sd_m=1.0),
    usbl=Usbl(**odd, latency_ns=0, ship_m=(0.0, 0.0), position_sd_m=1.0, bearing_sd_rad=0.01),
    bottom_track=BottomTracking(
        period_ns=10**9, range_m=50.0, beam_noise_sd_mps=0.01, missing_share=0.0, outlier_share=0.0, outlier_mps=0.0
    ),
)
config = EstimatorConfig()

warm_up(full if kind == "full" else base, config)
before = compiled()
estimator = Estimator(full if kind == "full" else base, config)
said = []
def feed(message):
    said.extend(estimator.step(message.t_ns, [ReceivedMessage(as_sent(message), 1, 0, message.t_ns)]))
still = {"north_m": 0.0, "east_m": 0.0}
feed(GnssFix(t_ns=0, **still, velocity_north_mps=0.0, velocity_east_mps=0.0))
feed(CompassHeading(t_ns=0, heading_rad=1.0))
feed(PressureDepth(t_ns=0, depth_m=0.1))
rng = np.random.default_rng(0)
for k in range(1, 301):
    t = k * 10_000_000
    rate = (0.01, 0.0, 0.02 + 1e-6 * k)
    feed(ImuSample(t_ns=t, interval_ns=10_000_000, angular_rate_radps=rate, specific_force_mps2=(0.0, 0.1, -9.8)))
    if k % 30 == 0:
        z = 0.02 * rng.standard_normal((4, 15))
        z[0, k // 30] = 5.0  # one beyond the gate
        z[1] = np.nan
        if k == 240:
            z[2:] = np.nan  # as many states as rows
        feed(AdcpPing(t_ns=t, range_m=1.0 + np.arange(15.0), beam_velocity_mps=z))
        feed(BottomTrack(t_ns=t, range_m=9.0 + 0 * z[:, 0], beam_velocity_mps=z[:, 0]))
        feed(LblRange(t_ns=t - 100_000_000, transponder=0, travel_time_s=0.08))
        feed(UsblFix(t_ns=t - 25_000_000, **still))
    if k % 10 == 0:
        feed(PressureDepth(t_ns=t, depth_m=0.1))
    if k % 100 == 0:
        feed(CompassHeading(t_ns=t, heading_rad=1.0))
        here = {"north_m": 1e-6 * k, "east_m": 0.0}  # the same again would be refused
        feed(TdcpFix(t_ns=t, from_t_ns=t - 10**9, **here))
        feed(GnssFix(t_ns=t, **here, velocity_north_mps=0.0, velocity_east_mps=0.0))
assert said and said[-1].t_ns == 3 * 10**9
used = {name for name, count in estimator.account.items() if count and name.endswith(".used")}
assert len(used) == (8 if kind == "full" else 5), used
"""

END = """
after = compiled()
assert sum(before.values()) > 5
assert "scipy.optimize" not in sys.modules  # a fifth of the start of a process
assert before == after, {key: (before.get(key), count) for key, count in after.items() if before.get(key) != count}
"""


@pytest.mark.parametrize(
    ("script", "kinds"), [(CONTROLLER, SOLVERS), (ESTIMATOR, ("base", "full"))], ids=["controller", "estimator"]
)
def test_no_function_is_compiled_after_the_warm_up(script, kinds):
    """Each kind in turn in a separate process, where no other test has compiled anything."""
    program = HEAD + "".join(f"kind = {kind!r}\n{script}{END}" for kind in kinds)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=240)
    assert ended.returncode == 0, ended.stderr[-2000:]
