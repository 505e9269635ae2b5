"""Picture of a harbour or a survey with a wreck: the path, the way that the vehicle takes, and one plan.

    .venv/bin/python -m benchmarks.fences.picture {harbour,survey} [--out FILE]

The vehicle ``paper`` follows the example of that name in examples/references with the fence of that name in
examples/fences, in a current of 0.1 m/s towards the south-east that the controller knows. It begins at rest on the
first point of the path, and moves as the model predicts.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from matplotlib.figure import Figure

from benchmarks import sheet
from benchmarks.paper import renderer
from ltv_mpc import references
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.nominal_model import advance
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.zones import clearances, pack_zones
from ltv_mpc.messages import Array, CurrentProfile, Estimate, FenceInForce, Pair, Plan
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots import catalogue, fence

ROOT = Path(__file__).resolve().parents[2]
OUT = {"harbour": ROOT / "docs/figures/fences.png", "survey": ROOT / "docs/figures/fences-survey.png"}
"""Picture of each example."""

WATER_MPS = 0.1 * math.sqrt(0.5), -0.1 * math.sqrt(0.5)
"""Current to the east and to the north."""

CYCLE_S = 0.3
MAX_CYCLES = 5000
SHOWN = {"reference": "path", "truth": "vehicle", "horizon": "one plan", "zones": "", "kept_free": "", "bounding": ""}
"""Tables of the view from above that are shown, with another label for some of their series."""


class Flown(NamedTuple):
    """One run along the path."""

    path: Array  # (P, 2) points of the reference (m)
    track: Array  # (K, 2) positions at the cycles (m)
    fence: FenceInForce
    shown: Plan  # the first plan that the wreck bounds
    least_m: float  # least clearance of the hull
    skipped_m: float  # length of the path that is left out


def fly(example: str) -> Flown:
    """Follow the reference of an example once.

    Parameters
    ----------
    example : name of its files.
    """
    vehicle, zones = Vehicle.load("paper"), Fence.load(str(ROOT / f"examples/fences/{example}.toml"))
    assert vehicle.hull is not None
    reference = references.load(str(ROOT / f"examples/references/{example}.toml"))
    controller = Controller(vehicle, reference)
    controller.set_fence(zones)
    path = reference.path().points  # type: ignore[union-attr]
    at, east, north = np.array([0.0, 1.0]), np.full(2, WATER_MPS[0]), np.full(2, WATER_MPS[1])
    estimate = msgspec.structs.replace(
        Estimate.at_rest(north_m=path[0, 0], east_m=path[0, 1]),
        velocity_north_mps=WATER_MPS[1],
        velocity_east_mps=WATER_MPS[0],
        current=CurrentProfile(depth_m=at, north_mps=north, east_mps=east),
    )
    track: list[Pair] = []
    shown, plan = None, controller.plan(estimate)
    while len(track) < MAX_CYCLES and (plan.progress or 0.0) < 1.0:
        plan = controller.plan(estimate)
        track.append((estimate.north_m, estimate.east_m))
        if shown is None and plan.fence is not None and any("wreck" in label for label in plan.fence.active):
            shown = plan
        estimate = advance(vehicle, estimate, plan, duration_s=CYCLE_S)
    assert shown is not None, "no plan is bounded by the wreck"
    assert plan.fence is not None
    least_m = float(clearances(pack_zones(zones), np.array(track)).min()) - vehicle.hull.radius_m
    return Flown(path, np.array(track), controller.fence_in_force(0), shown, least_m, plan.fence.skipped_m)


def draw(example: str, flown: Flown, out: Path) -> None:
    """Draw the picture as PNG or SVG.

    Parameters
    ----------
    example : its name.
    flown : one run along its path.
    out : the file.
    """
    lines = {"reference": flown.path, "truth": flown.track, "horizon": flown.shown.states[:, :2]}
    tables = {
        name: {"north_m": points[:, 0].tolist(), "east_m": points[:, 1].tolist()} for name, points in lines.items()
    }
    tables |= fence.tables(flown.fence, flown.shown)
    series = tuple(
        msgspec.structs.replace(one, label=SHOWN[one.table] or one.label)
        for one in catalogue.TRACK.series
        if one.table in SHOWN
    )
    with sheet.style(page=True):
        picture = Figure(figsize=(sheet.PAGE_IN, 6.2), layout="constrained")
        plot = msgspec.structs.replace(catalogue.TRACK, series=series)
        renderer.draw(
            picture.add_subplot(), plot, [renderer.Run(example, tables)], title=f"{example.capitalize()} from above"
        )
        sheet.write(picture, [out])


def main() -> None:
    """Fly, draw, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("example", choices=OUT, help="the reference and its fence")
    parser.add_argument("--out", type=Path, help="the picture, PNG or SVG; default: that of docs/figures")
    options = parser.parse_args()
    flown, out = fly(options.example), options.out or OUT[options.example]
    draw(options.example, flown, out)
    print(
        f"{out}: {len(flown.track) * CYCLE_S:.0f} s, least clearance of the hull {flown.least_m:.2f} m, "
        f"{flown.skipped_m:.1f} m of the path left out"
    )


if __name__ == "__main__":
    main()
