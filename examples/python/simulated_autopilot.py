"""Simulated autopilot: a boat behind MAVLink with the rules of ArduPilot Rover, for tests without a vehicle.

    python examples/python/simulated_autopilot.py udpout:127.0.0.1:14550 udpout:127.0.0.1:14551 [GCS_SYSID]

Each address is a link: `ltv-mpc mavlink --autopilot udpin:127.0.0.1:14550` at one, a ground station at the other. It
needs pymavlink and numpy, and nothing of this project. Its rules, as in ArduPilot 4.5:

- RC_CHANNELS_OVERRIDE counts from MAV_GCS_SYSID alone, and as that ground station's heartbeat. 0 releases a channel,
  65535 leaves it as it is. A channel that is not repeated for 3 s is released.
- In MANUAL steering and throttle are mixed for skid steering, the throttle in whole percent. Disarmed or in HOLD both
  thrusters stop.
- Without a heartbeat of the ground station for 5 s it changes to HOLD, and its state is critical until the next one.
- Messages are sent at the intervals that were asked for. What is not for it alone goes from each link to the others.
"""

from __future__ import annotations

import contextlib
import math
import socket
import sys
import time
from typing import Any, TypeAlias

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

STEP_S = 0.02
PWM_US = (1100, 1184, 1308, 1472, 1528, 1624, 1728, 1840, 1864, 1900)
PWM_N = (-39.9, -28.8, -13.2, 0.0, 0.0, 8.5, 21.8, 41.7, 46.2, 51.5)  # T200 at 16 V
MANUAL, HOLD = 0, 4
BOAT, ARDUPILOT = 11, 3
GCS_TIMEOUT_S, OVERRIDE_S = 5.0, 3.0
Datagram: TypeAlias = tuple[int, bytes]  # with its link; -1 - LINK: to all other links

ORIGIN_DEG = 50.2, -5.1
MISSION_INT = 4 | 8192  # capabilities: missions in integers, MAVLink 2


class Boat:
    """Boat of 14 kg: surge, sway and yaw with quadratic drag, two thrusters with lag."""

    def __init__(self) -> None:
        self.north = self.east = self.heading = self.surge = self.sway = self.rate = 0.0
        self.thrust = np.zeros(2)

    def step(self, command_N: tuple[float, float]) -> None:
        """Advance by 20 ms."""
        self.thrust += (np.array(command_N) - self.thrust) * STEP_S / 0.15
        port, starboard = self.thrust
        u, v, r = self.surge, self.sway, self.rate
        self.surge += STEP_S * (port + starboard - (4.0 + 9.0 * abs(u)) * u + 24.0 * v * r) / 16.0
        self.sway += STEP_S * (-(20.0 + 60.0 * abs(v)) * v - 16.0 * u * r) / 24.0
        self.rate += STEP_S * (0.3 * (port - starboard) - (4.0 + 6.0 * abs(r)) * r + (16.0 - 24.0) * u * v) / 3.0
        self.heading = math.remainder(self.heading + STEP_S * r, 2 * math.pi)
        north, east, _ = self.velocity()
        self.north, self.east = self.north + STEP_S * north, self.east + STEP_S * east

    def position(self) -> tuple[float, float, float]:
        """Return north, east, down (m)."""
        return self.north, self.east, 0.0

    def velocity(self) -> tuple[float, float, float]:
        """Return the velocity north, east, down (m/s)."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        return self.surge * c - self.sway * s, self.surge * s + self.sway * c, 0.0

    def attitude(self) -> tuple[float, float, float, float, float, float]:
        """Return roll, pitch, heading (rad) and the body's rates (rad/s)."""
        return 0.0, 0.0, self.heading, 0.0, 0.0, self.rate


class Autopilot:
    """ArduPilot Rover around a boat. ``receive`` and ``step`` return datagrams."""

    def __init__(
        self, boat: Any, *, gcs_sysid: int = 255, key: bytes | None = None, v1: bool = False, links: int = 2
    ) -> None:
        self.boat, self.gcs_sysid = boat, gcs_sysid
        self.mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.v1, self.links, self.sequence = v1, links, [0] * links
        if key is not None:
            self.mav.signing.secret_key, self.mav.signing.sign_outgoing = key, True
        self.ms, self.armed, self.mode, self.failsafe = 1000, False, MANUAL, False
        self.overrides: dict[int, tuple[int, float]] = {}  # by channel: PWM, time
        self.gcs_s: float | None = None
        self.intervals: dict[int, float] = {}
        self.sent_s: dict[int, float] = {}
        self.lists: dict[int, list[Any]] = {0: [], 1: [], 2: []}  # mission, fence, rally points
        self.upload: tuple[int, list[Any], tuple[int, int]] | None = None  # count, items, from whom
        self.current, self.pieces = 0, ""  # item of the mission; text that is under way
        self.actuated_while_disarmed = 0
        self.log: list[str] = []

    @property
    def now_s(self) -> float:
        """Time since its start (s)."""
        return self.ms * 1e-3

    def send(self, message: Any, link: int | None = None) -> list[Datagram]:
        """Return the datagram of a message for a link, or for each: a link has sequence numbers of its own."""
        out = []
        for one in range(self.links) if link is None else (link,):
            self.mav.seq = self.sequence[one] = (self.sequence[one] + 1) % 256
            out.append((one, bytes(message.pack(self.mav, force_mavlink1=self.v1))))
        return out

    def receive(self, data: bytes, link: int) -> list[Datagram]:
        """Take a datagram of one frame."""
        try:
            message = self.mav.decode(bytearray(data))
        except Exception:  # whatever pymavlink raises on damaged bytes
            return []
        out = self.handle(message, link)
        if getattr(message, "target_system", 0) != 1:  # its routing: to all other links
            out.append((-1 - link, data))
        return out

    def handle(self, m: Any, link: int) -> list[Datagram]:
        """Act on a message; return the answers."""
        kind, make = m.get_type(), self.mav
        who = (m.get_srcSystem(), m.get_srcComponent())
        if kind == "HEARTBEAT" and who[0] == self.gcs_sysid:
            self.failsafe &= self.gcs_s is None or self.now_s <= self.gcs_s + GCS_TIMEOUT_S
            self.gcs_s = self.now_s
        elif kind == "STATUSTEXT":
            self.pieces += m.text
            if m.id == 0 or len(m.text) < 50:  # the last piece
                self.log.append(self.pieces)
                print(self.pieces, flush=True)
                self.pieces = ""
        elif kind == "RC_CHANNELS_OVERRIDE" and who[0] == self.gcs_sysid:
            self.gcs_s = self.now_s
            for channel in range(1, 9):
                value = getattr(m, f"chan{channel}_raw")
                if value == 0:
                    self.overrides.pop(channel, None)
                elif value != 65535:
                    self.actuated_while_disarmed += not self.armed
                    self.overrides[channel] = value, self.now_s
        elif kind == "TIMESYNC" and m.tc1 == 0:
            return self.send(make.timesync_encode(self.ms * 1_000_000, m.ts1), link)
        elif kind == "SET_MODE":
            self.mode = m.custom_mode
        elif kind == "COMMAND_LONG":
            return self.command(m, who, link)
        elif kind == "MISSION_ITEM_REACHED":
            print(f"item {m.seq} reached", flush=True)
        elif kind == "MISSION_SET_CURRENT":
            self.current = m.seq
        elif kind.startswith("MISSION_"):
            return self.on_mission(m, kind, who, link)
        return []

    def command(self, m: Any, who: tuple[int, int], link: int) -> list[Datagram]:
        """Act on a COMMAND_LONG."""
        make, result, extra = self.mav, 0, []
        if m.command == 400:  # arm or disarm
            self.armed = m.param1 == 1.0
        elif m.command == 176:  # mode
            self.mode, self.failsafe = int(m.param2), False
        elif m.command == 511:  # interval of a message
            self.intervals[int(m.param1)] = m.param2 * 1e-6
        elif m.command == 512 and int(m.param1) == 148:  # AUTOPILOT_VERSION
            extra = self.send(make.autopilot_version_encode(MISSION_INT, 0, 0, 0, 0, *[bytes(8)] * 3, 0, 0, 1), link)
        else:
            result = 3  # unsupported
        return self.send(make.command_ack_encode(m.command, result, 0, 0, *who), link) + extra

    def on_mission(self, m: Any, kind: str, who: tuple[int, int], link: int) -> list[Datagram]:
        """Serve its mission, fence and rally points, and take others."""
        make, of, items = self.mav, m.mission_type, self.lists.get(m.mission_type)
        if items is None:
            return []
        denied = self.upload is not None and self.upload[2] != who
        if denied and kind != "MISSION_ACK":
            return self.send(make.mission_ack_encode(*who, 14, of), link)
        if kind == "MISSION_CLEAR_ALL":
            self.lists[of] = []
            return self.send(make.mission_ack_encode(*who, 0, of), link)
        if kind == "MISSION_REQUEST_LIST":
            return self.send(make.mission_count_encode(*who, len(items), of), link)
        if kind in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            if not 0 <= m.seq < len(items):
                return self.send(make.mission_ack_encode(*who, 13, of), link)
            item = items[m.seq]
            item.target_system, item.target_component, item.seq, item.mission_type = *who, m.seq, of
            return self.send(item, link)
        if kind == "MISSION_COUNT":
            self.upload = m.count, [], who
        if kind == "MISSION_ITEM_INT" and self.upload is not None and m.seq == len(self.upload[1]):
            self.upload[1].append(m)
        if kind in ("MISSION_COUNT", "MISSION_ITEM_INT") and self.upload is not None:
            count, got, _ = self.upload
            if len(got) < count:
                return self.send(make.mission_request_int_encode(*who, len(got), of), link)
            self.lists[of], self.upload = got, None
            text = [] if of else self.send(make.statustext_encode(6, b"Flight plan received"))
            return text + self.send(make.mission_ack_encode(*who, 0, of), link)
        return []

    def thrusts(self) -> tuple[float, float]:
        """Return the thrust of port and starboard (N) by mode, overrides and mix."""
        for channel, (_, at_s) in list(self.overrides.items()):
            if self.now_s > at_s + OVERRIDE_S:
                del self.overrides[channel]
        if not self.armed or self.mode != MANUAL:
            return 0.0, 0.0
        steering, throttle = ((self.overrides.get(channel, (1500, 0.0))[0] - 1500) / 400 for channel in (1, 3))
        throttle = math.trunc(min(max(throttle, -1.0), 1.0) * 100) / 100
        steering = min(max(steering, -1.0), 1.0)
        scale = max(1.0, abs(steering) + abs(throttle))
        left, right = (throttle + steering) / scale, (throttle - steering) / scale
        return tuple(float(np.interp(1500 + 400 * share, PWM_US, PWM_N)) for share in (left, right))  # type: ignore[return-value]

    def step(self) -> list[Datagram]:
        """Advance by 20 ms; return what is due."""
        self.boat.step(self.thrusts())
        self.ms += round(STEP_S * 1000)
        if self.gcs_s is not None and self.now_s > self.gcs_s + GCS_TIMEOUT_S and not self.failsafe:
            self.failsafe, self.mode = True, HOLD
        out, make = [], self.mav
        north, east, down = self.boat.position()
        speed = self.boat.velocity()
        for number, message in (
            (0, lambda: make.heartbeat_encode(BOAT, ARDUPILOT, 0x80 * self.armed + 1, self.mode, 4 + self.failsafe)),
            (2, lambda: make.system_time_encode(0, self.ms)),
            (30, lambda: make.attitude_encode(self.ms, *self.boat.attitude())),
            (32, lambda: make.local_position_ned_encode(self.ms, north, east, down, *speed)),
            (33, lambda: make.global_position_int_encode(self.ms, *self.degrees(north, east), 0, 0, 0, 0, 0, 0)),
            (42, lambda: make.mission_current_encode(self.current)),
            (49, lambda: make.gps_global_origin_encode(*(round(x * 1e7) for x in ORIGIN_DEG), 0)),
            (193, lambda: make.ekf_status_report_encode(0x1F, 0.1, 0.1, 0.1, 0.1, 0.1)),
        ):
            interval_s = 1.0 if number in (0, 33) else self.intervals.get(number, 0.0)
            if interval_s > 0.0 and self.now_s >= self.sent_s.get(number, -1.0) + interval_s - 1e-6:
                self.sent_s[number] = self.now_s
                out += self.send(message())
        return out

    @staticmethod
    def degrees(north: float, east: float) -> tuple[int, int]:
        """Return latitude and longitude in 1e-7 degrees, near the origin."""
        latitude = ORIGIN_DEG[0] + math.degrees(north / 6_367_000.0)
        longitude = ORIGIN_DEG[1] + math.degrees(east / 6_367_000.0 / math.cos(math.radians(latitude)))
        return round(latitude * 1e7), round(longitude * 1e7)


def main(arguments: list[str], autopilot: Autopilot | None = None) -> None:
    """Run in real time until it is ended; print each text that it receives."""
    urls = [one for one in arguments if ":" in one]
    numbers = [int(one) for one in arguments if ":" not in one]
    autopilot = autopilot or Autopilot(Boat(), gcs_sysid=numbers[0] if numbers else 255, links=len(urls))
    peers = [(host, int(port)) for _, host, port in (url.split(":") for url in urls)]
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in peers]
    for one in sockets:
        one.setblocking(False)
    due_s = time.monotonic()
    while True:
        out = []
        for link, one in enumerate(sockets):
            while True:
                try:
                    out += autopilot.receive(one.recv(4096), link)
                except OSError:
                    break
        for to, data in [*out, *autopilot.step()]:
            for link, one in enumerate(sockets):
                if to == link or (to < 0 and link != -1 - to):
                    with contextlib.suppress(OSError):
                        one.sendto(data, peers[link])
        due_s += STEP_S
        time.sleep(max(0.0, due_s - time.monotonic()))


if __name__ == "__main__":
    main(sys.argv[1:])
