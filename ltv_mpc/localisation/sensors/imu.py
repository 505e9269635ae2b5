"""Strapdown inertial unit: it propagates the filter (``filter/strapdown.py``) and has no measurement rows."""

from __future__ import annotations

from ltv_mpc.frames import GRAVITY_MPS2
from ltv_mpc.localisation.sensors.sensor import Sensor
from ltv_mpc.localisation.sensors.settings import PositiveSd, Sd, Seconds, SensorSettings
from ltv_mpc.messages import ImuSample


class Imu(SensorSettings, frozen=True, kw_only=True):
    """Strapdown inertial unit."""

    gyro_bias_sd_radps: Sd
    gyro_bias_tau_s: Seconds
    angle_random_walk_rad_per_rts: PositiveSd
    accelerometer_bias_sd_mps2: Sd
    accelerometer_bias_tau_s: Seconds
    velocity_random_walk_mps_per_rts: PositiveSd
    senses_earth_rate: bool


def _at_rest(t_ns: int, imu: Imu) -> ImuSample:
    """Return a sample whose rate differs from that of the sample before it: a repetition would be rejected."""
    return ImuSample(
        t_ns=t_ns,
        interval_ns=imu.period_ns,
        angular_rate_radps=(0.0, 0.0, 1e-9 * (t_ns // imu.period_ns)),
        specific_force_mps2=(0.0, 0.0, -GRAVITY_MPS2),
    )


IMU = Sensor(
    name="imu",
    message=ImuSample,
    settings=Imu,
    scalars_per_message=6,
    at_rest=_at_rest,
    linearise=None,
    reading=lambda sample: (sample.angular_rate_radps, sample.specific_force_mps2),
)
