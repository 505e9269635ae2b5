"""Hold with a navigation antenna away from the centre of the craft, declared in its vehicle file and not."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np

from ltv_mpc.messages import ModelCheck
from tests.foreign_plant.flight import CURRENT_MPS, HULL, Figure, Flight, distance_m
from tests.foreign_plant.plant import Sender

CENTRE, AHEAD, STARBOARD = (0.0, 0.0), (0.5, 0.0), (0.0, 0.5)
NEVER_S = 1e3


class AntennaFlight(Flight):
    """Flight whose estimates are those of an antenna ``forward_m`` and ``starboard_m`` of the centre."""

    def __init__(self, antenna_m: tuple[float, float], *, declared: bool, tells_current: bool = False) -> None:
        """Begin 3.6 m away from the point, armed. With ``tells_current`` the estimates contain the current."""
        self.antenna_m = antenna_m
        self.tells_current = tells_current
        self.thrusts_N: list[tuple[float, float]] = []
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "craft.toml"
            table = "\n[reference_point]\nforward_m = {}\nstarboard_m = {}\n".format(*antenna_m)
            file.write_text(HULL.read_text() + (table if declared else ""))
            super().__init__(vehicle=file, heading_rad=1.0)
        self.hull.x[0], self.hull.x[1] = 3.0, -2.0
        self.command(action="arm")

    def estimates(self, t_ns: int) -> Iterable[tuple[str, Sender, dict[str, Any]]]:
        """Return the estimate of the antenna."""
        self.thrusts_N.append(self.hull.thrust_N)
        fields, (x, y) = self.hull.estimate(t_ns), self.antenna_m
        heading, r = fields["heading_rad"], fields["yaw_rate_radps"]
        north, east = x * cos(heading) - y * sin(heading), x * sin(heading) + y * cos(heading)
        fields["north_m"] += north
        fields["east_m"] += east
        fields["velocity_north_mps"] -= r * east
        fields["velocity_east_mps"] += r * north
        if self.tells_current:
            north_mps, east_mps = CURRENT_MPS
            fields["current"] = {"depth_m": [0.0], "north_mps": [north_mps], "east_mps": [east_mps]}
        return [("estimate", self.sender, fields)]

    def hold(self) -> tuple[float, float]:
        """Hold the point. Return the largest distance (m) and the mean abs thrust (N), from 40 s to 90 s."""
        self.fly(40.0)
        self.thrusts_N.clear()
        farthest_m = float(distance_m(self.fly(50.0)).max())
        return farthest_m, float(np.abs(self.thrusts_N).mean())

    def said_s(self) -> float:
        """Return the time of the first model alarm that names the reference point, from the start (s)."""
        return next(
            (
                (check.t_ns - self.plans[0].cycle_t_ns) * 1e-9
                for check in self.outputs
                if isinstance(check, ModelCheck) and check.alarm and "[reference_point]" in check.why
            ),
            NEVER_S,
        )


def run() -> list[Figure]:
    """Return error and thrust with the antenna declared, and when the model check names one that is not."""
    _, centre_N = AntennaFlight(CENTRE, declared=False).hold()
    figures = []
    for name, antenna_m in (("ahead", AHEAD), ("to starboard", STARBOARD)):
        farthest_m, mean_N = AntennaFlight(antenna_m, declared=True).hold()
        undeclared = AntennaFlight(antenna_m, declared=False, tells_current=True)
        undeclared.fly(61.0)
        figures += [
            Figure(f"distance, antenna 0.5 m {name}", farthest_m, 0.05, "m"),
            Figure(f"thrust over that of the centre, 0.5 m {name}", mean_N / centre_N, 1.1, ""),
            Figure(f"undeclared 0.5 m {name}: named after", undeclared.said_s(), 60.0, "s"),
        ]
    return figures
