"""Compile what tests use and a descent does not, in one process: each worker of pytest would compile it for itself.

It runs beside the linters, which leave a core idle.
"""

from __future__ import annotations

import msgspec

from ltv_mpc import Controller, ControllerConfig, Estimate, Fence, references
from ltv_mpc.control.config import MotionLimits
from ltv_mpc.geofence.fence import Disc, Polygon
from ltv_mpc.references import Line, Place, Point, Reference
from ltv_mpc.vehicle.parameters import Hull, Vehicle
from services.processes import controller


def main() -> None:
    """Compile the cycle along references that are paths, and with a fence."""
    controller.warm_up(Vehicle.load("paper"), references.load("square"), ControllerConfig())
    goal = Place(north_m=20.0, east_m=0.0)
    plan_with_fence(Point(north_m=20.0, east_m=0.0))
    plan_with_fence(Line(start=Place(north_m=0.0, east_m=0.0), end=goal, speed_mps=0.3))


def plan_with_fence(reference: Reference) -> None:
    """Plan once towards a reference behind a disc and a wall, in a corridor, with the solver that has more kernels."""
    vehicle = msgspec.structs.replace(Vehicle.load("paper"), hull=Hull(length_m=1.2, beam_m=0.6))
    config = ControllerConfig(solver="riccati", limits=MotionLimits(max_cross_track_m=0.3))
    planner = Controller(vehicle, reference, config)
    wall = tuple(
        Place(north_m=north, east_m=east) for north, east in ((8.0, -2.0), (9.0, -2.0), (9.0, 2.0), (8.0, 2.0))
    )
    disc = Disc(centre=Place(north_m=14.0, east_m=0.0), radius_m=1.0)
    planner.set_fence(Fence(margin_m=0.2, keep_out=(Polygon(vertices=wall),), keep_out_disc=(disc,)))
    planner.plan(Estimate.at_rest())


if __name__ == "__main__":
    main()
