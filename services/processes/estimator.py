"""The estimator process: where the vehicle is and how the water moves, from sensor messages alone."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from ltv_mpc.frames import GRAVITY_MPS2
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.correction import update
from ltv_mpc.localisation.filter.error_state_filter import Aiding
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import (
    AdcpPing,
    BottomTrack,
    CompassHeading,
    GnssFix,
    ImuSample,
    LblRange,
    PressureDepth,
    TdcpFix,
    UsblFix,
)
from ltv_mpc.node import ReceivedMessage
from services.bus.session import BusOptions
from services.run.water import told
from services.runtime.clock import monotonic_us
from services.runtime.heartbeat import HEARTBEAT
from services.runtime.runner import Runner
from services.runtime.serve import serve
from services.runtime.stopping import Say, StopRequest


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """What the estimator process needs to start."""

    bus: BusOptions
    sensors: str = "paper"  # NAME or FILE
    settings: EstimatorConfig = EstimatorConfig()


def main(config: Config) -> int:
    """Publish an estimate each period, from whatever measures."""
    suite, settings = SensorConfig.load(config.sensors), config.settings
    prior = told(settings)
    warm_up(suite, settings)

    def make(request: StopRequest, say: Say) -> Runner:
        node = Estimator(suite, settings, prior, progress=lambda: HEARTBEAT.beat(monotonic_us()))
        return Runner(node, stop=request, say=say)

    return serve(Estimator.name, config.bus, make)


def warm_up(suite: SensorConfig, config: EstimatorConfig) -> None:
    """Have all compiled code loaded: a second afloat and at rest for a filter that is thrown away."""
    estimator = Estimator(suite, config)
    second, imu_ns = 1_000_000_000, suite.imu.period_ns
    adcp = suite.adcp
    range_m = adcp.blanking_m + adcp.cell_m * np.arange(0.5, max(1.0, (adcp.range_m - adcp.blanking_m) // adcp.cell_m))
    still = {"north_m": 0.0, "east_m": 0.0}
    messages: list[ImuSample | Aiding] = [
        GnssFix(t_ns=0, **still, velocity_north_mps=0.0, velocity_east_mps=0.0),
        CompassHeading(t_ns=0, heading_rad=0.0),
        PressureDepth(t_ns=0, depth_m=0.0),
    ]

    def sample(t_ns: int) -> ImuSample:
        rate = (0.0, 0.0, 1e-9 * (t_ns // imu_ns))  # the same again and again would be refused
        force = (0.0, 0.0, -GRAVITY_MPS2)
        return ImuSample(t_ns=t_ns, interval_ns=imu_ns, angular_rate_radps=rate, specific_force_mps2=force)

    messages += map(sample, range(imu_ns, second + 1, imu_ns))
    messages += [
        AdcpPing(t_ns=second, range_m=range_m, beam_velocity_mps=np.zeros((4, len(range_m)))),
        TdcpFix(t_ns=second, from_t_ns=0, **still),
        PressureDepth(t_ns=second, depth_m=0.0),
        CompassHeading(t_ns=second, heading_rad=0.0),
        GnssFix(t_ns=second, **still, velocity_north_mps=0.0, velocity_east_mps=0.0),
        BottomTrack(t_ns=second, range_m=np.ones(4), beam_velocity_mps=np.zeros(4)),
        sample(second + imu_ns),
        # late, so that the way back is walked too
        LblRange(t_ns=second, transponder=0, travel_time_s=1.0),
        UsblFix(t_ns=second // 2, **still),
    ]
    for message in messages:
        estimator.steps([(message.t_ns, [ReceivedMessage(message, 1, 0, message.t_ns)])])
    for states in (2, 8):  # many rows of few states, and of many: whichever this ping was not
        place, one = np.arange(8)[:, None] % states, np.ones((8, 1))
        update(np.eye(8), Rows(state=place, partial=one, residual=np.zeros(8), variance=np.ones(8)), math.inf)
