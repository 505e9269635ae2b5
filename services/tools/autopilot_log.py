"""Log of ArduPilot (DataFlash .bin, telemetry .tlog): estimates, and the thrusts that its outputs command.

    DataFlash   XKF1 (NKF1): attitude, velocity, position of the EKF;  IMU: yaw rate;  RCOU: PWM;  PARM;  ARM, EV
    telemetry   ATTITUDE, LOCAL_POSITION_NED;  SERVO_OUTPUT_RAW;  PARAM_VALUE;  HEARTBEAT

The outputs of port and starboard are those with SERVOn_FUNCTION 73 and 74 (ThrottleLeft, ThrottleRight). The vehicle
file's ``pwm_us`` and ``pwm_N`` make thrusts of them. While the autopilot is disarmed nothing is known. DataFlash begins
with arming (LOG_DISARMED = 0) if its first event is to disarm, or if it has none.

Telemetry is of the first autopilot that it has. Its outputs are stamped in microseconds, which begin again after 71
minutes, and all its stamps begin again when it is restarted: here they are counted on.
"""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.config import open_file
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Estimate, Times
from ltv_mpc.vehicle.parameters import Vehicle
from services.edges.mavlink.autopilot import ARDUPILOT
from services.edges.mavlink.navigation import RESTART_MS, Accuracy, Navigation

SUFFIXES = (".bin", ".tlog")
FMT, STX = b"\xa3\x95\x80", (b"\xfe", b"\xfd")
"""First bytes of DataFlash, and those of a frame of MAVLink, which follow a time of 8 bytes in telemetry."""
LEFT_RIGHT = (73, 74)
"""SERVOn_FUNCTION of port and starboard."""
DEFAULT_OUTPUTS = (1, 3)
"""Their outputs by default, on a rover with skid steering."""
WRAP_US = 1 << 32
ARMED, DISARMED, SAFETY_ARMED = 10, 11, 128
"""Events of DataFlash, and the flag of HEARTBEAT.base_mode."""


class AutopilotLog(NamedTuple):
    """Estimates and commanded thrusts of a log."""

    estimates: list[Estimate]
    t_ns: Times  # (M,) of the outputs
    command_N: Array  # (M, 2) of port and starboard
    armed: npt.NDArray[np.bool_]  # (M,)
    notes: list[str]


class _Rows(NamedTuple):
    """Estimates, outputs and parameters of a log, in their order."""

    estimates: list[Estimate]
    outputs: list[tuple[int, dict[int, float], bool | None]]  # time (ns), PWM (us) by output, armed; None: unknown
    functions: dict[int, int]  # SERVOn_FUNCTION by output


def read(path: Path, vehicle: Vehicle) -> AutopilotLog:
    """Read a log. Raises ``ConfigError``."""
    source = f"log {path}"
    with open_file(path, what="log") as file:  # pymavlink opens it by its name, and is slow on other files
        head = file.read(9)
    if (path.suffix.lower() == ".bin" and head[:3] != FMT) or (path.suffix.lower() == ".tlog" and head[8:] not in STX):
        raise ConfigError(source, "", "is no log of ArduPilot: it does not begin as one")
    try:
        navigation = Navigation(Accuracy(), dives=vehicle.can_dive)
        rows = (_telemetry if path.suffix.lower() == ".tlog" else _data_flash)(path, navigation)
    except ImportError:
        raise ConfigError(source, "", 'is of ArduPilot: install the extra "mavlink", pymavlink') from None
    except (OSError, ValueError, TypeError, AttributeError, KeyError, IndexError, struct.error) as error:
        raise ConfigError(source, "", f"cannot be read: {error}") from None
    notes, outputs = [], [n for wanted in LEFT_RIGHT for n, f in rows.functions.items() if f == wanted]
    if not rows.functions:
        outputs = [*DEFAULT_OUTPUTS]
        notes.append(f"no SERVOn_FUNCTION in the log: outputs {DEFAULT_OUTPUTS} are taken for port and starboard")
    if len(outputs) != len(LEFT_RIGHT):
        raise ConfigError(source, "SERVOn_FUNCTION", f"must have {LEFT_RIGHT} once, ThrottleLeft and ThrottleRight")
    if not rows.outputs or not rows.estimates:
        raise ConfigError(source, "", "has no outputs, or no position of the EKF")
    thrusts = []
    for name, output, thruster in zip(("port", "starboard"), outputs, vehicle.thrusters, strict=False):
        if not thruster.pwm_us:
            raise ConfigError(
                f"vehicle {vehicle.name}", f"[thruster.{name}] pwm_us", "is missing: it makes thrusts of PWM"
            )
        pwm = np.array([row[1].get(output, math.nan) for row in rows.outputs])
        order = np.argsort(thruster.pwm_us)
        thrusts.append(np.interp(pwm, np.array(thruster.pwm_us)[order], np.array(thruster.pwm_N)[order]))
    before = not next((row[2] for row in rows.outputs if row[2] is not None), False)
    t_ns, armed = (
        np.array([row[0] for row in rows.outputs]),
        [before if row[2] is None else row[2] for row in rows.outputs],
    )
    if rows.outputs[-1][2] is None:
        notes.append("no ARM in the log: it is taken as armed from begin to end")
    return AutopilotLog(rows.estimates, t_ns, np.column_stack(thrusts), np.array(armed), notes)


def _data_flash(path: Path, navigation: Navigation) -> _Rows:
    from pymavlink import DFReader

    rows, rates = _Rows([], [], {}), (0.0, 0.0)
    armed: bool | None = None
    for message in _messages(DFReader.DFReader_binary(str(path), zero_time_base=True)):
        kind = message.get_type()
        if kind in ("XKF1", "NKF1") and getattr(message, "C", 0) == 0:
            roll, pitch, yaw = (math.radians(degrees) for degrees in (message.Roll, message.Pitch, message.Yaw))
            stamp, (q, r) = message.TimeUS // 1000, rates
            attitude = {"roll": roll, "pitch": pitch, "yaw": yaw, "pitchspeed": q, "yawspeed": r}
            place = {"x": message.PN, "y": message.PE, "z": message.PD}
            velocity = {"vx": message.VN, "vy": message.VE, "vz": message.VD}
            rows.estimates.extend(navigation.attitude(SimpleNamespace(time_boot_ms=stamp, **attitude)))
            rows.estimates.extend(navigation.position(SimpleNamespace(time_boot_ms=stamp, **place, **velocity)))
        elif kind == "IMU" and getattr(message, "I", 0) == 0:
            rates = message.GyrY, message.GyrZ
        elif kind == "RCOU":
            pwm = {n: float(getattr(message, f"C{n}", math.nan)) for n in range(1, 15)}
            rows.outputs.append((message.TimeUS * 1000, pwm, armed))
        elif kind == "PARM":
            _parameter(rows, message.Name, message.Value)
        elif kind == "ARM":
            armed = bool(message.ArmState)
        elif kind == "EV" and message.Id in (ARMED, DISARMED):
            armed = message.Id == ARMED
    return rows


def _telemetry(path: Path, navigation: Navigation) -> _Rows:
    from pymavlink import mavutil

    rows, armed, system, boot = _Rows([], [], {}), False, 0, _BootTime()
    for message in _messages(mavutil.mavlogfile(str(path))):
        kind, by = message.get_type(), message.get_srcSystem()
        if by != (system or by):
            continue
        if kind == "HEARTBEAT" and message.get_srcComponent() == 1 and message.autopilot == ARDUPILOT:
            system, armed = by, bool(message.base_mode & SAFETY_ARMED)
        elif system == 0:
            continue
        elif kind in ("ATTITUDE", "LOCAL_POSITION_NED"):
            message.time_boot_ms = boot.add(message.time_boot_ms)
            take = navigation.attitude if kind == "ATTITUDE" else navigation.position
            rows.estimates.extend(take(message))
        elif kind == "SERVO_OUTPUT_RAW" and message.port == 0:
            pwm = {n: float(getattr(message, f"servo{n}_raw")) for n in range(1, 9)}
            t_ns = boot.of_us(message.time_usec) * 1000
            if not rows.outputs or t_ns > rows.outputs[-1][0]:
                rows.outputs.append((t_ns, pwm, armed))
        elif kind == "PARAM_VALUE":
            _parameter(rows, message.param_id, message.param_value)
    return rows


class _BootTime:
    """Time since the first start of an autopilot, counted on when it starts again."""

    def __init__(self) -> None:
        self._newest_ms = self._before_ms = 0

    def add(self, boot_ms: int) -> int:
        """Return the time (ms) of a stamp (ms since the newest start)."""
        if self._before_ms + boot_ms < self._newest_ms - RESTART_MS:
            self._before_ms = self._newest_ms + RESTART_MS
        ms = self._before_ms + boot_ms
        self._newest_ms = max(ms, self._newest_ms)
        return ms

    def of_us(self, boot_us: int) -> int:
        """Return the time (us) of a stamp of 32 bits (us since the newest start), which is near the newest."""
        newest_us = (self._newest_ms - self._before_ms) * 1000
        late_us = (newest_us - boot_us + WRAP_US // 2) % WRAP_US - WRAP_US // 2
        return self._newest_ms * 1000 - late_us


def _messages(log: Any) -> Iterator[Any]:
    with contextlib.closing(log):
        while (message := log.recv_msg()) is not None:
            yield message


def _parameter(rows: _Rows, name: str, value: float) -> None:
    number = name.removeprefix("SERVO").removesuffix("_FUNCTION")
    if name.endswith("_FUNCTION") and number.isdecimal():
        rows.functions[int(number)] = int(value)
