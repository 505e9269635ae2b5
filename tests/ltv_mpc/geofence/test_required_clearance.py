"""Required clearances: margin or uncertainty, less where two zones are too near to each other, and exits."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control.fencing import update_required
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.zones import pack_zones
from tests.ltv_mpc.geofence.shapes import disc, fence_of, polygon
from tests.ltv_mpc.geofence.test_half_planes import NOTCH, SQUARE


def test_the_required_clearance_has_the_margin_or_three_standard_deviations() -> None:
    zones, need = pack_zones(Fence(margin_m=1.0, keep_out=(polygon(SQUARE), polygon(NOTCH, 4.0)))), np.empty(2)
    update_required(zones, 50.0, 50.0, 0.5, 0.2, need, np.zeros((2, 4)))
    np.testing.assert_allclose(need, [1.5, 4.5])
    update_required(zones, 50.0, 50.0, 0.5, 0.7, need, np.zeros((2, 4)))
    np.testing.assert_allclose(need, [2.6, 4.5])
    update_required(zones, 50.0, 50.0, 0.5, 0.7, need, np.zeros((2, 4)), 0.25)  # the model's error comes on top
    np.testing.assert_allclose(need, [2.85, 4.75])


def test_an_exit_is_that_of_the_entry_until_the_vehicle_is_out() -> None:
    zones, exits, need = pack_zones(fence_of(SQUARE - 25.0, keep_in=False)), np.zeros((1, 4)), np.empty(1)

    def exit_at(north_m: float, east_m: float) -> list[float]:
        update_required(zones, north_m, east_m, 0.5, 0.0, need, exits)
        return list(exits[0])

    assert exit_at(-14.9, -20.0)[0] == 0.0  # outside, and in the circle around the zone
    assert exit_at(-16.0, -20.0) == pytest.approx([1.0, 1.0, 0.0, -15.0])  # out to the north
    assert exit_at(-20.0, -24.9) == pytest.approx([1.0, 1.0, 0.0, -15.0])  # the west is nearer now
    assert exit_at(-10.0, -30.0)[0] == 0.0
    assert exit_at(-20.0, -24.9) == pytest.approx([1.0, 0.0, -1.0, 25.0])


@pytest.mark.parametrize(("margin_m", "sd_m", "least_m"), [(4.0, 0.0, 0.55), (0.2, 2.0, 0.7), (0.2, 0.0, 0.7)])
def test_zones_too_near_to_each_other_ask_for_no_more_than_there_is(
    margin_m: float, sd_m: float, least_m: float
) -> None:
    """The hull has 1 m to either side; at a wall nothing but hull, or hull and a margin that it has, is asked for."""
    zones = pack_zones(Fence(margin_m=margin_m, keep_out_disc=(disc(0.0, -4.5, 3.0), disc(0.0, 4.5, 3.0))))
    need, exits, alone_m = np.full(2, 0.5 + margin_m), np.zeros((2, 4)), 0.5 + max(margin_m, 3.0 * sd_m)
    asked = []
    for east_m in np.concatenate([np.linspace(0.0, 1.0, 40), np.linspace(1.0, 0.0, 40)]):
        update_required(zones, 0.0, float(east_m), 0.5, sd_m, need, exits)
        asked.append(need.copy())
    if alone_m < 1.5:
        np.testing.assert_allclose(asked, alone_m)
        return
    assert np.min(asked) == pytest.approx(least_m)
    assert np.sum(asked, axis=1).max() <= 3.0 + 2.0 * 0.05 + 1e-9  # what there is, and the slack
    assert asked[0] == pytest.approx([1.5 + 0.05] * 2 if margin_m > 1.0 else [1.25] * 2)


def test_where_not_even_the_margins_fit_the_hull_is_asked_for_at_least() -> None:
    zones = pack_zones(Fence(margin_m=1.2, keep_out_disc=(disc(0.0, -4.0, 3.0), disc(0.0, 4.0, 3.0))))
    need, exits = np.full(2, 1.7), np.zeros((2, 4))
    assert update_required(zones, 0.0, 0.0, 0.5, 0.0, need, exits) == 2
    assert need == pytest.approx([1.05, 1.05])
    assert update_required(zones, 0.0, 0.6, 0.5, 0.0, need, exits) == 2  # the hull is 0.1 m in the second
    assert need == pytest.approx([1.35, 0.55])


def test_a_zone_that_is_alone_asks_for_all_wherever_the_vehicle_is() -> None:
    zones = pack_zones(Fence(margin_m=4.0, keep_out_disc=(disc(0.0, -4.5, 3.0), disc(0.0, 40.0, 3.0))))
    need = np.full(2, 4.5)
    assert update_required(zones, 0.0, 0.0, 0.5, 0.0, need, np.zeros((2, 4))) == 1
    assert need.tolist() == [4.5, 4.5]
