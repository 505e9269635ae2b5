"""Processes in real time: the simulated autopilot, `ltv-mpc mavlink`, a controller, and a ground station by MAVSDK."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from typing import Any

import pytest

pytest.importorskip("mavsdk", minversion=None, reason="not installed: pip install mavsdk (extra dev)")

from services.supervisor import loopback
from tests.foreign_plant.mavlink_flight import ROOT
from tests.services.edges.mavlink.ground_station import PLACES
from tests.system.alone import CLI, Lines, arm, controller, started

MAVSDK_SYSTEM = "245"


@pytest.mark.timeout(400)
def test_a_mission_of_another_ground_station_is_driven() -> None:
    """It uploads, arms and reads telemetry; the boat drives to the second place."""
    own, station = loopback.free_port(), loopback.free_port()
    simulated = ROOT / "examples/python/simulated_autopilot.py"
    links = (f"udpout:127.0.0.1:{own}", f"udpout:127.0.0.1:{station}", MAVSDK_SYSTEM)
    arguments = ("--vehicle", "bluerobotics-boat", "--reference", "hover")
    with controller(loopback.free_port(), arguments) as (endpoint, _):
        edge = (*CLI, "mavlink", "--autopilot", f"udpin:127.0.0.1:{own}", "--connect", endpoint)
        ground = (sys.executable, "-P", "-m", "tests.services.edges.mavlink.ground_station", str(station))
        with (
            started(*edge, "--gcs-sysid", MAVSDK_SYSTEM),
            started(sys.executable, "-P", str(simulated), *links) as (_, autopilot),
        ):
            autopilot.until(lambda line: "autopilot disarmed" in line, within_s=90.0)
            drive(ground, autopilot, endpoint)
            second = "2: 50.20004, -5.09996"  # said while it begins to drive: read already, or still to be read
            if not any(second in line for line in autopilot.said):
                autopilot.until(lambda line: second in line, within_s=60.0)


def drive(ground: Sequence[str], autopilot: Lines, endpoint: str) -> None:
    """Upload, arm and see the boat come to its second place."""
    with started(*ground) as (_, said):
        lines: list[dict[str, Any]] = []

        def until(wanted: Any) -> dict[str, Any]:
            def matches(line: str) -> bool:
                if line.startswith("{"):
                    lines.append(json.loads(line))
                    return bool(wanted(lines[-1]))
                return False

            return json.loads(said.until(matches, within_s=150.0))  # type: ignore[no-any-return]

        assert until(lambda line: "system" in line)["system"] == 1
        assert until(lambda line: "uploaded" in line)["uploaded"] == len(PLACES)
        until(lambda line: "armed" in line)
        autopilot.until(lambda line: "controller disarmed" in line, within_s=90.0)
        arm(CLI, endpoint)
        autopilot.until(lambda line: "driving" in line and "not" not in line, within_s=60.0)
        until(lambda line: "latitude_deg" in line and metres(line, PLACES[1]) < 2.0)


def metres(line: dict[str, Any], place: tuple[float, float]) -> float:
    """Return the distance of a position from a place (m)."""
    north = math.radians(line["latitude_deg"] - place[0]) * 6_367_000.0
    east = math.radians(line["longitude_deg"] - place[1]) * 6_367_000.0 * math.cos(math.radians(place[0]))
    return math.hypot(north, east)
