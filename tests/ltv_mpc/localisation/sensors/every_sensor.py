"""Sensor configuration of a vehicle that has every sensor of the registry, and the matrix of a measurement."""

from __future__ import annotations

import msgspec
import numpy as np

from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.bottom_track import BottomTracking
from ltv_mpc.localisation.sensors.lbl import Lbl
from ltv_mpc.localisation.sensors.sensor import Rows
from ltv_mpc.localisation.sensors.usbl import Usbl

S = 1_000_000_000
UNDISTURBED = {"period_ns": S, "missing_share": 0.0, "outlier_share": 0.0}
REALISTIC = SensorConfig.load("realistic")
EVERY_SENSOR = msgspec.structs.replace(
    REALISTIC,
    pressure=msgspec.structs.replace(REALISTIC.pressure, lever_arm_m=(0.0, 0.0, 0.0)),
    bottom_track=BottomTracking(**UNDISTURBED, range_m=20.0, beam_noise_sd_mps=0.01, outlier_mps=0.5),
    lbl=Lbl(
        **UNDISTURBED,
        transponders_m=((0.0, 0.0, 750.0),),  # half a second of sound away
        sound_speed_mps=1500.0,
        sound_speed_sd_mps=0.0,
        range_sd_m=1.0,
        outlier_m=0.0,
    ),
    usbl=Usbl(**UNDISTURBED, latency_ns=0, ship_m=(0.0, 0.0), position_sd_m=1.0, bearing_sd_rad=0.0, outlier_m=0.0),
)


def with_settings(sensors, **tables):
    """Return the sensors with settings changed, by sensor."""
    changed = {name: msgspec.structs.replace(getattr(sensors, name), **values) for name, values in tables.items()}
    return msgspec.structs.replace(sensors, **changed)


def dense(rows: Rows, size: int) -> np.ndarray:
    """Return the measurement matrix (m, n) for a state of ``size`` n."""
    H = np.zeros((len(rows.residual), size))
    np.add.at(H, (np.arange(len(H))[:, None], rows.state), rows.partial)
    return H
