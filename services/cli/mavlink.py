"""Command ``mavlink``: edge to ArduPilot."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from services.cli.bus import with_bus
from services.cli.options import flag, invalid, needs, option

if TYPE_CHECKING:
    from services.bus.options import BusOptions
    from services.edges.mavlink.navigation import Accuracy


@with_bus("mavlink")
def mavlink(
    autopilot: Annotated[
        str, option("udpin|udpout:HOST:PORT", "Where the autopilot sends, or listens.")
    ] = "udpin:127.0.0.1:14550",
    gcs_sysid: Annotated[int, option("N", "MAV_GCS_SYSID of the autopilot.", min=1, max=255)] = 255,
    vehicle: Annotated[
        str, option("NAME|FILE", "Vehicle, with pwm_us and pwm_N of each thruster.")
    ] = "bluerobotics-boat",
    signing_key: Annotated[Path | None, option("FILE", "32 bytes: signed frames alone, both ways.")] = None,
    sd: Annotated[
        str, option("P,V,H,R", "Standard deviations that it does not send: m, m/s, rad, rad/s of yaw.")
    ] = "1,0.1,0.05,0.01",
    no_mission: Annotated[bool, flag("--no-mission", "Ignore the mission and the fence of the autopilot.")] = False,
    *,
    bus: BusOptions,
) -> int:
    """Connect to ArduPilot: position in, thrusts out.

    Reads plan and controller/status; writes estimate, command and applied. It replaces the estimator.
    """
    from ltv_mpc.vehicle.parameters import Vehicle

    with needs("pymavlink", "mavlink", "mavlink"):
        from services.edges.mavlink.edge import Settings
        from services.processes import mavlink as process
    host, port, listens = _address(autopilot)
    of = Vehicle.load(vehicle)
    if missing := [n for n, t in (("port", of.thruster.port), ("starboard", of.thruster.starboard)) if not t.pwm_us]:
        problem = f"[thruster.{missing[0]}] has no pwm_us and pwm_N: the vehicle bluerobotics-boat has them"
        raise invalid(f"vehicle {vehicle}", problem)
    key = None if signing_key is None else _key(signing_key)
    edge = Settings(vehicle=of, ground_station=gcs_sysid, accuracy=_accuracy(sd), follow_mission=not no_mission)
    config = process.Config(bus=bus, host=host, port=port, listens=listens, edge=edge, signing_key=key)
    return process.main(config)


def _accuracy(text: str) -> Accuracy:
    """Return the standard deviations of a text. Raises ``ConfigError``."""
    from services.edges.mavlink.navigation import Accuracy

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 4 or not all(0.0 < value < 1e3 for value in values):
        raise invalid("option --sd", "must be four numbers above 0, as in 1,0.1,0.05,0.01", value=text)
    return Accuracy(*values)


def _key(path: Path) -> bytes:
    """Return the 32 bytes of a file. Raises ``ConfigError``."""
    from ltv_mpc.config import read_bytes

    key = read_bytes(path, what="option --signing-key")
    if len(key) != 32:
        raise invalid(f"option --signing-key {path}", f"has {len(key)} bytes, must be 32")
    return key


def _address(text: str) -> tuple[str, int, bool]:
    """Return host, port, and whether the edge listens there. Raises ``ConfigError``."""
    found = re.fullmatch("(udpin|udpout):(.+):([0-9]{1,5})", text)
    if found is None or not 1 <= int(found[3]) <= 65_535:
        problem = "must be udpin:HOST:PORT or udpout:HOST:PORT, as in udpin:127.0.0.1:14550"
        raise invalid("option --autopilot", problem, value=text)
    return found[2], int(found[3]), found[1] == "udpin"
