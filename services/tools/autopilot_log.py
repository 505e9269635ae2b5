"""Log of ArduPilot (DataFlash .bin, telemetry .tlog): estimates, and the thrusts that its outputs command.

    DataFlash   XKF1 (NKF1): attitude, velocity, position of the EKF;  IMU: yaw rate;  RCOU: PWM;  PARM;  ARM, EV
    telemetry   ATTITUDE, LOCAL_POSITION_NED;  SERVO_OUTPUT_RAW;  PARAM_VALUE;  HEARTBEAT

The outputs of port and starboard are those with SERVOn_FUNCTION 73 and 74 (ThrottleLeft, ThrottleRight). The vehicle
file's ``pwm_us`` and ``pwm_N`` make thrusts of them. While the autopilot is disarmed nothing is known. DataFlash begins
with arming (LOG_DISARMED = 0) if its first event is to disarm, or if it has none.

Telemetry is of the first autopilot that it has. Its outputs are stamped in microseconds, which begin again after 71
minutes, and all its stamps begin again when it is restarted: here they are counted on.

Damage costs itself and is counted: bytes that are no message, values that cannot be, stamps that do not increase.
"""

from __future__ import annotations

import contextlib
import io
import math
import struct
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.config import open_file
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.pd0.reader import increasing
from ltv_mpc.messages import Array, Estimate, Times
from ltv_mpc.vehicle.parameters import Vehicle
from services.edges.edge import Refused
from services.edges.mavlink.autopilot import ARDUPILOT
from services.edges.mavlink.navigation import RESTART_MS, Accuracy, Navigation

SUFFIXES = (".bin", ".tlog")
FMT, STX = b"\xa3\x95\x80", (b"\xfe", b"\xfd")
"""First bytes of DataFlash, and those of a frame of MAVLink, which follow a time of 8 bytes in telemetry."""
LEFT_RIGHT = (73, 74)
"""SERVOn_FUNCTION of port and starboard."""
DEFAULT_OUTPUTS = (1, 3)
"""Their outputs by default, on a rover with skid steering."""
WRAP_US, MAX_US = 1 << 32, 1 << 53
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
    damaged: set[str]  # a text for each place

    def take(self, convert: Callable[[Any], Iterable[Estimate]], message: Any) -> None:
        """Add the estimates of a message of position or attitude, if it can be one."""
        try:
            self.estimates.extend(convert(message))
        except Refused as refusal:
            self.damaged.add(f"{message.time_boot_ms} ms: {refusal}")


def read(path: Path, vehicle: Vehicle) -> AutopilotLog:
    """Read a log. Raises ``ConfigError``."""
    source = f"log {path}"
    with open_file(path, what="log") as file:  # pymavlink opens it by its name, and is slow on other files
        head = file.read(9)
    if (path.suffix.lower() == ".bin" and head[:3] != FMT) or (path.suffix.lower() == ".tlog" and head[8:] not in STX):
        raise ConfigError(source, "", "is no log of ArduPilot: it does not begin as one")
    rows, printed = _Rows([], [], {}, set()), io.StringIO()  # pymavlink prints damaged places, some of them twice
    try:
        navigation = Navigation(Accuracy(), dives=vehicle.can_dive)
        with contextlib.redirect_stderr(printed), contextlib.redirect_stdout(printed):
            (_telemetry if path.suffix.lower() == ".tlog" else _data_flash)(path, navigation, rows)
        rows.damaged.update(text for text in printed.getvalue().splitlines() if text.startswith(("Skipped", "Failed")))
    except ImportError:
        raise ConfigError(source, "", 'is of ArduPilot: install the extra "mavlink", pymavlink') from None
    except (OSError, ValueError, TypeError, AttributeError, LookupError, struct.error, RecursionError) as error:
        raise ConfigError(source, "", f"cannot be read: {error}") from None
    estimates = _in_order(rows.estimates, [one.t_ns for one in rows.estimates], rows.damaged)
    outputs = _in_order(rows.outputs, [one[0] for one in rows.outputs], rows.damaged)
    notes, numbers = list[str](), [n for wanted in LEFT_RIGHT for n, f in rows.functions.items() if f == wanted]
    if not rows.functions:
        numbers = [*DEFAULT_OUTPUTS]
        notes.append(f"no SERVOn_FUNCTION in the log: outputs {DEFAULT_OUTPUTS} are taken for port and starboard")
    if len(numbers) != len(LEFT_RIGHT):
        raise ConfigError(source, "SERVOn_FUNCTION", f"must have {LEFT_RIGHT} once, ThrottleLeft and ThrottleRight")
    if not outputs or not estimates:
        raise ConfigError(source, "", "has no outputs, or no position of the EKF")
    t_ns, pwm, arming = zip(*outputs, strict=True)
    thrusts = []
    for name, number, thruster in zip(("port", "starboard"), numbers, vehicle.thrusters, strict=False):
        if not thruster.pwm_us:
            where = f"[thruster.{name}] pwm_us"
            raise ConfigError(f"vehicle {vehicle.name}", where, "is missing: it makes thrusts of PWM")
        order, us = np.argsort(thruster.pwm_us), [row.get(number, math.nan) for row in pwm]
        thrusts.append(np.interp(us, np.array(thruster.pwm_us)[order], np.array(thruster.pwm_N)[order]))
    before = not next((one for one in arming if one is not None), False)
    armed = np.array([before if one is None else one for one in arming])
    if arming[-1] is None:
        notes.append("no ARM in the log: it is taken as armed from begin to end")
    if rows.damaged:
        notes.append(f"the log is damaged in {len(rows.damaged)} places: what is there is left out")
    return AutopilotLog(estimates, np.array(t_ns), np.column_stack(thrusts), armed, notes)


def _data_flash(path: Path, navigation: Navigation, rows: _Rows) -> None:
    from pymavlink import DFReader

    binary = DFReader.DFReader_binary
    reader = type("Reader", (binary,), {"init_arrays_fast": binary.init_arrays})  # that one prints past sys.stderr
    armed: bool | None = None
    rates = 0.0, 0.0
    for message in _messages(reader(str(path), zero_time_base=True)):
        kind, t_us = message.get_type(), getattr(message, "TimeUS", 0)
        if not 0 <= t_us < MAX_US:
            rows.damaged.add(f"time {t_us} us")
        elif kind in ("XKF1", "NKF1") and getattr(message, "C", 0) == 0:
            roll, pitch, yaw = (math.radians(degrees) for degrees in (message.Roll, message.Pitch, message.Yaw))
            stamp, (q, r) = t_us // 1000, rates
            attitude = {"roll": roll, "pitch": pitch, "yaw": yaw, "pitchspeed": q, "yawspeed": r}
            place = {"x": message.PN, "y": message.PE, "z": message.PD}
            velocity = {"vx": message.VN, "vy": message.VE, "vz": message.VD}
            rows.take(navigation.attitude, SimpleNamespace(time_boot_ms=stamp, **attitude))
            rows.take(navigation.position, SimpleNamespace(time_boot_ms=stamp, **place, **velocity))
        elif kind == "IMU" and getattr(message, "I", 0) == 0:
            rates = message.GyrY, message.GyrZ
        elif kind == "RCOU":
            pwm = {n: float(getattr(message, f"C{n}", math.nan)) for n in range(1, 15)}
            rows.outputs.append((t_us * 1000, pwm, armed))
        elif kind == "PARM":
            _parameter(rows, message.Name, message.Value)
        elif kind == "ARM":
            armed = bool(message.ArmState)
        elif kind == "EV" and message.Id in (ARMED, DISARMED):
            armed = message.Id == ARMED


def _telemetry(path: Path, navigation: Navigation, rows: _Rows) -> None:
    from pymavlink import mavutil

    armed, system, boot = False, 0, _BootTime()
    for message in _messages(mavutil.mavlogfile(str(path))):
        kind, by = message.get_type(), message.get_srcSystem()
        if kind == "BAD_DATA":
            rows.damaged.add(f"byte {len(rows.damaged)}")
        elif by != (system or by):
            continue
        elif kind == "HEARTBEAT" and message.get_srcComponent() == 1 and message.autopilot == ARDUPILOT:
            system, armed = by, bool(message.base_mode & SAFETY_ARMED)
        elif system == 0:
            continue
        elif kind in ("ATTITUDE", "LOCAL_POSITION_NED"):
            message.time_boot_ms = boot.add(message.time_boot_ms)
            rows.take(navigation.attitude if kind == "ATTITUDE" else navigation.position, message)
        elif kind == "SERVO_OUTPUT_RAW" and message.port == 0:
            pwm = {n: float(getattr(message, f"servo{n}_raw")) for n in range(1, 9)}
            rows.outputs.append((boot.of_us(message.time_usec) * 1000, pwm, armed))
        elif kind == "PARAM_VALUE":
            _parameter(rows, message.param_id, message.param_value)


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


def _in_order(messages: list[Any], stamps: list[int], damaged: set[str]) -> list[Any]:
    """Return the most messages whose stamps increase."""
    kept = increasing(stamps)
    damaged.update(f"stamp {stamps[k]}" for k in set(range(len(stamps))).difference(kept))
    return [messages[k] for k in kept]


def _parameter(rows: _Rows, name: str, value: float) -> None:
    number = name.removeprefix("SERVO").removesuffix("_FUNCTION")
    if name.endswith("_FUNCTION") and number.isdecimal():
        rows.functions[int(number)] = int(value)
