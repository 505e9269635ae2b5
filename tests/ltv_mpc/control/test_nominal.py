"""Choice of the trajectory that a cycle linearises along, where a zone lies in the way of one of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltv_mpc import Vehicle
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.nominal import PREVIOUS_PLAN, STEERED_AHEAD, Cycle, choose_nominal
from ltv_mpc.control.ocp.fence import Scene, fence_cost
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.resolution import settled
from ltv_mpc.geofence.allowed_path import NO_ZONES
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.zones import pack_zones
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import coefficients
from tests.ltv_mpc.control import fence_scenes
from tests.ltv_mpc.geofence.shapes import disc
from tests.ltv_mpc.vehicles import changed

WEAK = Vehicle.load("weak-reverse")
CONFIG = settled(ControllerConfig(), WEAK)
N = CONFIG.stages
CONSTANTS = Constants.of(WEAK, CONFIG.weights, CONFIG.knots)


def scene(*discs: tuple[float, float]) -> Scene:
    """Return a scene with discs of 1 m around these places."""
    zones = tuple(disc(*place, 1.0) for place in discs)
    return fence_scenes.scene(
        zones=pack_zones(Fence(margin_m=0.0, keep_out_disc=zones)) if zones else NO_ZONES,
        need=np.full(len(discs), 0.5),
        exits=np.zeros((len(discs), 4)),
        discs=np.empty((0, 7)),
        targets=np.zeros(N, dtype=np.int64),
    )


def chosen(of: Scene) -> tuple[int, Array, float]:
    """Return which trajectory is chosen, its states, and its cost for the zones.

    The vehicle holds its place 8 m east of the target, full astern in a current to the east. To come nearer it has to
    turn round, and the current carries it away to the east meanwhile.
    """
    cycle = Cycle(CONSTANTS, of)
    cycle.set_fence_rows(3)
    cycle.lin.C[:] = 0.0, 0.25
    astern = CONSTANTS.low
    start = np.array([0.0, 8.0, -0.25, 0.0, math.pi / 2, 0.0, *astern, *astern])
    kind = choose_nominal(cycle, start, np.tile(astern, (N + 1, 1)), 0.0, was_clear=True)
    return kind, cycle.lin.X.copy(), fence_cost(cycle.lin.X, of, CONSTANTS.t, CONSTANTS.state_scale[0])


def test_what_follows_the_horizon_counts_only_for_a_way_free_of_zones() -> None:
    """The turn costs more within the horizon than to stay, and pays off after it; but not through a zone."""
    kind, turn, _ = chosen(scene())
    assert kind == STEERED_AHEAD
    east_m = turn[:, 1].max()
    for k in (4 * N // 5, N - 1):
        kind, stay, clearances = chosen(scene((turn[k, 0], turn[k, 1])))
        assert kind == PREVIOUS_PLAN
        assert clearances == 0.0
        assert stay[:, 1].max() < east_m - 1.0
    assert chosen(scene((0.0, east_m + 10.0)))[0] == STEERED_AHEAD


@pytest.mark.parametrize(("in_the_way", "expected"), [(True, PREVIOUS_PLAN), (False, STEERED_AHEAD)])
def test_a_guess_through_a_zone_does_not_replace_a_plan_through_it(in_the_way: bool, expected: int) -> None:
    """The plan goes on beyond the target, where the guess stops, and so it costs more; both lead through the zone."""
    of, ahead = scene((0.1, 4.6)) if in_the_way else scene(), CONSTANTS.high
    cycle = Cycle(CONSTANTS, of)
    cycle.set_fence_rows(3)
    cycle.lin.C[:] = 0.0
    start = np.array([0.0, 6.0, 0.3, 0.0, -math.pi / 2, 0.0, *ahead, *ahead])
    kind = choose_nominal(cycle, start, np.tile(ahead, (N + 1, 1)), 0.0, was_clear=True)
    assert kind == expected


def test_the_pattern_of_a_problem_is_that_of_the_vehicle_whatever_was_learned_before() -> None:
    """Masses ahead and abeam that are equal have no Munk moment, until one is learned."""
    even = changed(WEAK, {"sway.mass_kg": WEAK.surge.mass_kg})
    patterns = []
    for learned in (0.0, 20.0):
        constants = Constants.of(even, CONFIG.weights, CONFIG.knots)
        cycle = Cycle(constants._replace(p=np.array(even.coefficients()._replace(added_munk=learned))), scene())
        full = cycle.full_problem()
        patterns.append([np.asarray(values) != 0.0 for values in full])
        assert coefficients(cycle.constants.p).added_munk == learned
    for one, other in zip(*patterns, strict=True):
        np.testing.assert_array_equal(one, other)
