"""Time of a control cycle with a fence over that without one, interleaved cycle by cycle.

    .venv/bin/python -m benchmarks.fences.cycle_time [--scenes N]

In each of N scenes (``scenes.py``) a controller flies with the fence. In each cycle two more continue from its state
and plan from the same estimate: one without a fence, and one with the fence 1 km away. So the motion is the same, and
the difference is the fence's. A cycle counts as active if a zone bounds the plan that is flown. Cycles take one of
several times, by the sweeps of their QPs, so the ratio of two medians can jump between these: the median of the ratios
in the same cycle does not.
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

KINDS = ("no zone active", "a zone active")
FENCES = ("no fence", "fence 1 km away", "fence")


def far_away(fence: Fence) -> Fence:
    """Return the fence, moved to the north."""

    def moved(place: Place) -> Place:
        return msgspec.structs.replace(place, north_m=(place.north_m or 0.0) + FAR_M)

    return msgspec.structs.replace(
        fence,
        keep_out=tuple(Polygon(vertices=tuple(moved(v) for v in zone.vertices)) for zone in fence.keep_out),
        keep_out_disc=tuple(Disc(centre=moved(d.centre), radius_m=d.radius_m) for d in fence.keep_out_disc),
    )


def times_of(scene: Scene) -> list[tuple[str, tuple[float, ...]]]:
    """Fly a scene; return the kind of each cycle and its times (s) with each of ``FENCES``."""
    assert scene.fence is not None
    controllers = []
    for fence in (None, far_away(scene.fence), scene.fence):
        controller = Controller(
            scene.vehicle, Point(north_m=scene.goal[0], east_m=scene.goal[1]), settings_of(scene.name)
        )
        controller.set_fence(fence)
        controllers.append(controller)
    flying, estimate, found = controllers[-1], estimate_at_start(scene), []
    for k in range(CYCLES):
        state, spent = flying.save(estimate.t_ns), []
        for controller in controllers:
            if controller is not flying:
                controller.restore(state, estimate.t_ns)
            began = time.perf_counter()
            plan = controller.plan(estimate)
            spent.append(time.perf_counter() - began)
        is_active = plan.fence is not None and bool(plan.fence.active)
        if k >= WARM_UP:
            found.append((KINDS[is_active], tuple(spent)))
        estimate = advance(scene.vehicle, estimate, plan, duration_s=CYCLE_NS * 1e-9)
    return found


def main() -> None:
    """Fly, and print times over those without a fence in the same cycles."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=6)
    options = parser.parse_args()
    scenes = (scene_of(seed, moving=False) for seed in range(1000))
    some = [scene for scene, _ in zip((s for s in scenes if s.fence), range(options.scenes + 1), strict=False)]
    times_of(some[0])  # compiles
    gc.disable()
    found = [row for scene in some[1:] for row in times_of(scene)]
    print(f"{sorted({settings_of(scene.name).stages for scene in some})} stages, {len(some) - 1} scenes")
    print("| cycles | number | fence | median (ms) | over the median alone | median of the ratios | 99 % (ms) |")
    print("|---|---|---|---|---|---|---|")
    for kind in KINDS:
        spent = np.array([times for k, times in found if k == kind])
        alone = np.median(spent[:, 0])
        for fence, times in zip(FENCES, spent.T, strict=True):
            middle, high, paired = np.median(times), np.quantile(times, 0.99), np.median(times / spent[:, 0])
            print(
                f"| {kind} | {len(times)} | {fence} | {1e3 * middle:.2f} | {middle / alone:.2f} | {paired:.2f} | "
                f"{1e3 * high:.2f}, {high / alone:.2f} of the median alone |"
            )


if __name__ == "__main__":
    main()
