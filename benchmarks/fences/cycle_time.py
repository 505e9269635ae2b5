"""Time of a control cycle with a fence over that without one, interleaved cycle by cycle.

    .venv/bin/python -m benchmarks.fences.cycle_time [--scenes N]

In each of N scenes (``scenes.py``) three controllers fly at the same time, each its own loop, and take turns: without a
fence, with the fence 1 km away, and with the fence. A cycle counts as active if a zone bounds its plan.
"""

from __future__ import annotations

import argparse
import gc
import time

import msgspec
import numpy as np

from benchmarks.fences.flight import CYCLE_NS
from benchmarks.fences.scenes import Scene, estimate_at_start, scene_of, settings_of
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.nominal_model import advance
from ltv_mpc.geofence.fence import Disc, Fence, Polygon
from ltv_mpc.references import Place, Point

FAR_M = 1000.0
CYCLES = 300
WARM_UP = 10
"""Cycles of each flight that are not counted."""

KINDS = ("no fence", "fence 1 km away", "fence, no zone active", "fence, a zone active")


def far_away(fence: Fence) -> Fence:
    """Return the fence, moved to the north."""

    def moved(place: Place) -> Place:
        return msgspec.structs.replace(place, north_m=(place.north_m or 0.0) + FAR_M)

    return msgspec.structs.replace(
        fence,
        keep_out=tuple(Polygon(vertices=tuple(moved(v) for v in zone.vertices)) for zone in fence.keep_out),
        keep_out_disc=tuple(Disc(centre=moved(d.centre), radius_m=d.radius_m) for d in fence.keep_out_disc),
    )


def times_of(scene: Scene) -> list[tuple[str, float]]:
    """Fly a scene; return the kind and the time (s) of each cycle."""
    assert scene.fence is not None
    controllers, found = [], []
    for fence in (None, far_away(scene.fence), scene.fence):
        controller = Controller(
            scene.vehicle, Point(north_m=scene.goal[0], east_m=scene.goal[1]), settings_of(scene.name)
        )
        controller.set_fence(fence)
        controllers.append(controller)
    estimates = [estimate_at_start(scene)] * len(controllers)
    for k in range(CYCLES):
        for i, controller in enumerate(controllers):
            began = time.perf_counter()
            plan = controller.plan(estimates[i])
            spent = time.perf_counter() - began
            is_active = plan.fence is not None and bool(plan.fence.active)
            if k >= WARM_UP:
                found.append((KINDS[i + (i == 2 and is_active)], spent))
            estimates[i] = advance(scene.vehicle, estimates[i], plan, duration_s=CYCLE_NS * 1e-9)
    return found


def main() -> None:
    """Fly, and print medians and 99 % quantiles over those without a fence."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=6)
    options = parser.parse_args()
    scenes = (scene_of(seed, moving=False) for seed in range(1000))
    some = [scene for scene, _ in zip((s for s in scenes if s.fence), range(options.scenes + 1), strict=False)]
    times_of(some[0])  # compiles
    gc.disable()
    found = [row for scene in some[1:] for row in times_of(scene)]
    alone = np.array([spent for kind, spent in found if kind == KINDS[0]])
    print(f"{sorted({settings_of(scene.name).stages for scene in some})} stages, {len(some) - 1} scenes")
    print("| cycles | number | median (ms) | over that alone | 99 % (ms) | over that alone | over the median alone |")
    print("|---|---|---|---|---|---|---|")
    for kind in KINDS:
        spent = np.array([s for k, s in found if k == kind])
        if len(spent):
            middle, high = np.median(spent), np.quantile(spent, 0.99)
            print(
                f"| {kind} | {len(spent)} | {1e3 * middle:.2f} | {middle / np.median(alone):.2f} | {1e3 * high:.2f} | "
                f"{high / np.quantile(alone, 0.99):.2f} | {high / np.median(alone):.2f} |"
            )


if __name__ == "__main__":
    main()
