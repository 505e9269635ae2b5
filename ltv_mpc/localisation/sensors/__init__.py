"""Registry of the sensors, one line a sensor, and their measurement models, one file a sensor.

A sensor's file holds its settings, its measurement model and its description (``Sensor``). ``sim/sensors`` mirrors this
folder: one file and one line a sensor. How to add one: docs/add-sensor.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, get_type_hints

from ltv_mpc.localisation.sensors.adcp import ADCP, Adcp
from ltv_mpc.localisation.sensors.bottom_track import BOTTOM_TRACK, BottomTracking
from ltv_mpc.localisation.sensors.compass import COMPASS, Compass
from ltv_mpc.localisation.sensors.gnss import GNSS, Gnss
from ltv_mpc.localisation.sensors.imu import IMU, Imu
from ltv_mpc.localisation.sensors.lbl import LBL, Lbl
from ltv_mpc.localisation.sensors.pressure import PRESSURE, Pressure
from ltv_mpc.localisation.sensors.sensor import AnySensor
from ltv_mpc.localisation.sensors.settings import SensorSettings, Table
from ltv_mpc.localisation.sensors.tdcp import TDCP, Tdcp
from ltv_mpc.localisation.sensors.usbl import USBL, Usbl
from ltv_mpc.messages import ImuSample, ImuSamples, Message


class SensorTables(Table, frozen=True, kw_only=True):
    """Settings of every sensor under its name. A vehicle may lack those whose default is None."""

    imu: Annotated[Imu, IMU]
    gnss: Annotated[Gnss, GNSS]
    tdcp: Annotated[Tdcp, TDCP]
    adcp: Annotated[Adcp, ADCP]
    pressure: Annotated[Pressure, PRESSURE]
    compass: Annotated[Compass, COMPASS]
    bottom_track: Annotated[BottomTracking | None, BOTTOM_TRACK] = None
    lbl: Annotated[Lbl | None, LBL] = None
    usbl: Annotated[Usbl | None, USBL] = None


SENSORS: tuple[AnySensor, ...] = tuple(
    hint.__metadata__[0] for hint in get_type_hints(SensorTables, include_extras=True).values()
)
"""Every sensor that the estimator knows, in the order of the registry."""

BY_MESSAGE: Mapping[type[Any], AnySensor] = {sensor.message: sensor for sensor in SENSORS}
BY_NAME: Mapping[str, AnySensor] = {sensor.name: sensor for sensor in SENSORS}

PUBLISHED: Mapping[str, type[Message]] = {
    sensor.name: ImuSamples if sensor.message is ImuSample else sensor.message for sensor in SENSORS
}
"""Messages of each sensor on the bus, by its name: inertial samples travel several at a time."""


def fitted(tables: SensorTables) -> Iterator[tuple[AnySensor, SensorSettings]]:
    """Iterate over the sensors of a vehicle that correct its filter, with the settings of each."""
    for sensor in SENSORS:
        settings = getattr(tables, sensor.name)
        if sensor.linearise is not None and settings is not None:
            yield sensor, settings
