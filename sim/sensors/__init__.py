"""Simulated sensors: one file a sensor, with its equations and its random stream, and one line here.

The folder mirrors ``ltv_mpc/localisation/sensors``: a name below is the name of a sensor in that registry.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from sim.sensors.adcp import Instrument, Profiler
from sim.sensors.bottom_track import BottomTracker
from sim.sensors.compass import MagneticCompass
from sim.sensors.gnss import GnssReceiver
from sim.sensors.imu import InertialUnit
from sim.sensors.lbl import AcousticTransceiver
from sim.sensors.pressure import PressureGauge
from sim.sensors.simulated import Environment, SimulatedSensor
from sim.sensors.tdcp import CarrierPhaseReceiver
from sim.sensors.usbl import ShipTransceiver

SIMULATED: Mapping[str, Callable[[Any, Environment], SimulatedSensor]] = {
    "imu": lambda imu, e: InertialUnit(imu, e.sensor_config.latitude_rad, e.seed),
    "gnss": lambda gnss, e: GnssReceiver(gnss, e.seed),
    "tdcp": lambda tdcp, e: CarrierPhaseReceiver(tdcp, e.seed, e.sensor_config.gnss.lever_arm_m),
    "adcp": lambda adcp, e: Profiler(Instrument(adcp, e.seed), e.water, e.seed, e.bottom_m),
    "bottom_track": lambda bed, e: BottomTracker(bed, Instrument(e.sensor_config.adcp, e.seed), e.bottom_m, e.seed),
    "pressure": lambda pressure, e: PressureGauge(pressure, e.seed),
    "compass": lambda compass, e: MagneticCompass(compass, e.seed),
    "usbl": lambda usbl, e: ShipTransceiver(usbl, e.seed),
    "lbl": lambda lbl, e: AcousticTransceiver(lbl, e.seed),
}
"""How each sensor is made from its settings and its environment.

Messages of one instant are published in this order. The inertial unit stands first: its interval ends before another
sensor measures at its end.
"""
