"""Fence and obstacles of a controller node: commands, publications, and what another node continues with."""

from __future__ import annotations

import msgspec
import pytest

from ltv_mpc import Fence, Vehicle, references
from ltv_mpc.config import to_toml
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import SAVE_PERIOD_NS
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.operator_commands import FENCE_PERIOD_NS, OBSTACLES_PERIOD_NS
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Disc
from ltv_mpc.messages import Action, Command, FenceInForce, Health, Obstacle, Obstacles
from ltv_mpc.references.geodesy import Place
from tests.ltv_mpc.control.flights import PERIOD_NS, Flight, armed

FAR = Fence(margin_m=2.0, keep_out_disc=(Disc(name="wreck", centre=Place(north_m=500.0, east_m=0.0), radius_m=3.0),))
POINT = references.Point(north_m=0.0, east_m=0.0)


def command(flight: Flight, toml: str) -> str:
    """Send another fence; return why it was rejected."""
    flight.step(Command(command_id=7, action=Action.FENCE, fence_toml=toml))
    return flight.answers[-1].why


def published(flight: Flight) -> list[FenceInForce]:
    return [message for message in flight.messages if isinstance(message, FenceInForce)]


def ship(flight: Flight, number: int = 12) -> Obstacles:
    """Return a report of a ship 300 m away, as of now."""
    t_ns = flight.estimate.t_ns
    velocity = {"velocity_north_mps": 1.0, "velocity_east_mps": 0.0}
    one = Obstacle(id=number, t_ns=t_ns, north_m=0.0, east_m=300.0, radius_m=10.0, **velocity)
    return Obstacles(t_ns=t_ns, obstacles=(one,))


def test_a_fence_is_published_when_it_changes_and_then_from_time_to_time():
    flight = armed(POINT, 5)
    assert published(flight) == []
    assert command(flight, to_toml(FAR)) == ""
    (first,) = published(flight)
    assert [zone.label for zone in first.zones] == ['keep_out_disc[0] "wreck"']
    assert (first.zones[0].radius_m, first.zones[0].margin_m) == (3.0, 2.0)
    flight.fly(2 * FENCE_PERIOD_NS // PERIOD_NS + 3)
    assert len(published(flight)) == 3
    assert command(flight, "") == ""
    assert published(flight)[-1].zones == ()
    flight.fly(FENCE_PERIOD_NS // PERIOD_NS + 3)
    assert len(published(flight)) == 4


@pytest.mark.parametrize(
    ("toml", "why"),
    [
        ("margin_m = 1.0", "no zone"),
        ("margin_m = ", "not valid TOML"),
        (to_toml(FAR).replace("radius_m = 3.0", "radius_m = -3.0"), "radius_m"),
    ],
)
def test_a_fence_that_cannot_be_read_is_rejected_and_the_old_one_stays(toml, why):
    flight = armed(POINT, 5)
    command(flight, to_toml(FAR))
    assert why in command(flight, toml)
    assert flight.node.controller.fence == FAR
    assert len(published(flight)) == 1


def test_a_node_that_replaces_another_one_keeps_its_fence():
    flight = armed(POINT, 5)
    command(flight, to_toml(FAR))
    after, state = flight.handed_over(0.0)
    after.step(state)
    assert after.node.controller.fence == FAR
    assert [zone.label for zone in published(after)[0].zones] == ['keep_out_disc[0] "wreck"']
    command(flight, "")
    again, state = flight.handed_over(0.0)
    again.step(state)
    assert again.node.controller.fence is None


def surveyed(latitude_deg: float) -> tuple[references.Point, Fence]:
    """Return a point and a fence of one origin."""
    origin = references.Origin(latitude_deg=latitude_deg, longitude_deg=5.0)
    return msgspec.structs.replace(POINT, origin=origin), msgspec.structs.replace(FAR, origin=origin)


def follow(flight: Flight, reference: references.Reference) -> str:
    """Send another reference; return why it was rejected."""
    flight.step(Command(command_id=8, action=Action.FOLLOW, reference_toml=to_toml(reference)))
    return flight.answers[-1].why


def test_a_fence_and_a_reference_from_other_origins_are_rejected_where_they_meet():
    (here, fence), (there, other) = surveyed(60.0), surveyed(50.0)
    flight = armed(here, 2)
    assert "is 1,111," in command(flight, to_toml(other))
    assert flight.node.controller.fence is None
    assert command(flight, to_toml(fence)) == ""
    assert "away from the origin of the reference, 50.000000, 5.000000" in follow(flight, there)
    assert flight.node.controller.fence == fence
    assert flight.node.controller.follower.reference == here
    flight.fly(SAVE_PERIOD_NS // PERIOD_NS + 1)
    assert flight.states[-1].reference_toml == to_toml(here)
    assert follow(flight, POINT) == ""  # in metres, without an origin
    with pytest.raises(ConfigError, match="origin"):
        ControllerNode(Vehicle.load("paper"), here, ControllerConfig(), fence=other)


def test_a_node_that_replaces_another_one_keeps_a_mission_from_another_origin():
    (here, fence), (there, other) = surveyed(60.0), surveyed(50.0)
    flight = armed(here, 2)
    assert follow(flight, there) == command(flight, to_toml(other)) == ""
    _, state = flight.handed_over(0.0)
    after = Flight(None, node=ControllerNode(Vehicle.load("paper"), here, ControllerConfig(), fence=fence))
    after.step(state)
    assert after.node.controller.fence == other
    assert after.node.controller.follower.reference == there


def test_obstacles_are_published_once_a_second_from_the_first_report_on():
    flight = armed(POINT, 5)
    flight.step(ship(flight))
    assert [one.id for one in published(flight)[0].obstacles] == [12]
    for _ in range(10):
        flight.step(ship(flight, 13))
    steps = 10 * PERIOD_NS // OBSTACLES_PERIOD_NS
    assert 1 + steps - 1 <= len(published(flight)) <= 1 + steps
    assert {one.id for one in published(flight)[-1].obstacles} == {12, 13}


def test_obstacles_that_cannot_be_avoided_degrade_the_health():
    flight = Flight(
        POINT, node=ControllerNode(msgspec.structs.replace(Vehicle.load("paper"), hull=None), POINT, ControllerConfig())
    )
    assert flight.step().health is Health.NOMINAL
    plan = flight.step(ship(flight))
    assert plan.health is Health.DEGRADED
    assert "[hull]" in plan.health_why
    assert published(flight) == []
