"""State of the autopilot and of the ground station, and with it whether the edge may drive.

ArduPilot takes RC_CHANNELS_OVERRIDE from the system number of its ground station alone (MAV_GCS_SYSID), and counts
each as that ground station's heartbeat. So while the edge drives, the autopilot cannot see that the ground station is
lost: the edge watches for it. It looks for heartbeats of a ground station with that number and another component.
"""

from __future__ import annotations

import enum
from typing import Any

from services.edges.edge import Refused
from services.edges.mavlink.codec import COMPONENT

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
GROUND_STATION = 6  # MAV_TYPE_GCS
ARMED = 0x80  # MAV_MODE_FLAG_SAFETY_ARMED
CRITICAL, EMERGENCY = 5, 6  # MAV_STATE: a failsafe acts
TIMEOUT_US = 3_000_000
"""Silence of the autopilot after which it counts as lost: three heartbeats."""

STATION_TIMEOUT_US = 5_000_000
"""Silence of the ground station after which it counts as lost, as in ArduPilot (FS_GCS_TIMEOUT)."""


class Kind(enum.Enum):
    """Kind of vehicle, with its mode MANUAL."""

    ROVER = 0
    SUB = 19


KINDS = {10: Kind.ROVER, 11: Kind.ROVER, 12: Kind.SUB}
"""Kind by MAV_TYPE: ground rover, surface boat, submarine."""

MODES = {
    Kind.ROVER: {0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 10: "AUTO", 11: "RTL", 15: "GUIDED"},
    Kind.SUB: {0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 9: "SURFACE", 16: "POSHOLD"},
}  # fmt: skip


class Autopilot:
    """Autopilot by its heartbeats, and the ground station by its own."""

    def __init__(self, ground_station: int) -> None:
        """``ground_station``: system number."""
        self._ground_station = ground_station
        self._seen_us = self.heard_us = self._station_us = -(10**12)
        self.channel = ""
        """Channel of its newest frame that was accepted, at ``heard_us``: the autopilot is answered there."""
        self.rival: str | None = ""
        """Another sender in its name, which is asked too; None once the channel has answered a request."""
        self.system = 0  # system number of the autopilot; 0: none yet
        self.kind: Kind | None = None
        self.armed = False
        self.mode = -1
        self.failsafe = False

    def check_channel(self, channel: str, now_us: int, *, signed: bool, answers: bool) -> None:
        """Raise ``Refused`` for a frame of the autopilot on another channel than before.

        Anybody can send one that is not ``signed``. It is accepted once the present channel has been silent for
        ``TIMEOUT_US``, or if it ``answers`` a request, which the present channel never has: a stranger that was there
        first, and only sends.
        """
        if channel != self.channel:
            if not (signed or now_us > self.heard_us + TIMEOUT_US or (answers and self.rival is not None)):
                self.rival = None if self.rival is None else channel
                raise Refused(f"second sender for autopilot {self.system}: {channel} beside {self.channel}")
            self.rival = ""
        if answers:
            self.rival = None

    def heartbeat(self, message: Any, now_us: int) -> None:
        """Take a heartbeat. Raises ``Refused`` for an autopilot that cannot be driven."""
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if message.type == GROUND_STATION:
            if system == self._ground_station and component != COMPONENT:
                self._station_us = now_us
            return
        if component != AUTOPILOT or (self.system and system != self.system):
            return  # a camera, a gimbal, another vehicle
        if message.autopilot != ARDUPILOT or message.type not in KINDS:
            raise Refused(f"autopilot {message.autopilot} of type {message.type}: must be ArduPilot Rover or Sub")
        self.system, self.kind = system, KINDS[message.type]
        self.armed = bool(message.base_mode & ARMED)
        self.mode = message.custom_mode
        self.failsafe = message.system_status in (CRITICAL, EMERGENCY)
        self._seen_us = now_us

    def is_from(self, message: Any) -> bool:
        """Return True for a message of the autopilot."""
        sender = message.get_srcSystem(), message.get_srcComponent()
        return self.system != 0 and sender == (self.system, AUTOPILOT)

    @property
    def is_manual(self) -> bool:
        """True in its mode MANUAL."""
        return self.kind is not None and self.mode == self.kind.value

    def station_is_there(self, now_us: int) -> bool:
        """Return True if the ground station has sent a heartbeat recently."""
        return now_us <= self._station_us + STATION_TIMEOUT_US

    def why_not(self, now_us: int) -> str:
        """Return why the edge may not drive, and what to do; empty if it may."""
        if self.kind is None:
            return "no autopilot; check its link"
        if now_us > self._seen_us + TIMEOUT_US:
            return "autopilot lost; check its link"
        if self.failsafe:
            return "autopilot in failsafe; end its cause and set MANUAL"
        if not self.armed:
            return "autopilot disarmed; arm it"
        if not self.is_manual:
            return f"autopilot in mode {MODES[self.kind].get(self.mode, self.mode)}; set MANUAL"
        if not self.station_is_there(now_us):
            return f"ground station {self._ground_station} lost; check its link and MAV_GCS_SYSID"
        return ""
