"""Warm-up of the estimator: no function is left to be compiled after it."""

import subprocess
import sys

SCRIPT = """
import math, sys
import msgspec, numpy as np
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

def compiled():
    return {
        (name, key): len(value.signatures)
        for name, module in list(sys.modules.items()) if name.startswith("ltv_mpc")
        for key, value in vars(module).items() if hasattr(value, "nopython_signatures")
    }

warm_up(full if sys.argv[1] == "full" else base, config)
before = compiled()
estimator = Estimator(full if sys.argv[1] == "full" else base, config)
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
assert len(used) == (8 if sys.argv[1] == "full" else 5), used
after = compiled()
assert sum(before.values()) > 5
assert before == after, {key: (before.get(key), count) for key, count in after.items() if before.get(key) != count}
"""


def test_no_function_is_compiled_after_the_warm_up():
    """In processes of their own: whatever else the tests have compiled would hide it."""
    for suite in ("base", "full"):
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT, suite], capture_output=True, text=True, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr[-2000:]
