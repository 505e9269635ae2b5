"""Hold and square through the edge to MAVLink and the simulated autopilot, on a good link and on one with faults.

A fifth of the frames is lost, a fifth comes late behind others, a fifth comes twice, in each direction.
"""

from __future__ import annotations

from ltv_mpc.control.config import ControllerConfig
from tests.foreign_plant.flight import SQUARE, Figure, distance_m
from tests.foreign_plant.mavlink_flight import Faults, MavlinkFlight
from tests.foreign_plant.scenarios.square import distance_from_outline_m

BAD = Faults(lost=0.2, reordered=0.2, repeated=0.2)


def run() -> list[Figure]:
    """Return the distances from the point and from the outline, and what the edge refused."""
    figures = []
    for name, faults, hold_m, square_m, square_s in (
        ("good link", Faults(), 0.3, 0.6, 60.0),  # two corners
        ("bad link", BAD, 0.5, 0.8, 110.0),
    ):
        flight = MavlinkFlight(faults=faults, heading_rad=1.0, config=ControllerConfig(effort="high"))
        flight.hull.x[0], flight.hull.x[1] = 3.0, -2.0
        flight.fly(5.0)
        flight.arm()
        flight.command(action="arm")
        flight.fly(40.0)
        figures.append(Figure(f"distance, {name}", float(distance_m(flight.fly(40.0)).max()), hold_m, "m"))
        flight.command(action="follow", reference_toml=SQUARE.read_text())
        off_m = distance_from_outline_m(flight.fly(square_s))
        figures.append(Figure(f"distance from the outline, {name}", float(off_m.max()), square_m, "m"))
        edge, sent = flight.edge, flight.frames["to edge"]
        figures.append(Figure(f"frames refused, {name}", float(edge.refused), 0.0, "frames"))
        figures.append(Figure(f"frames counted as lost, {name}", edge.lost / sent, 1.1 * faults.lost + 0.001, "share"))
    return figures
