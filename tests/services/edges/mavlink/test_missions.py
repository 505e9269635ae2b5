"""Missions of an autopilot: the legs of its items, refusals by number and name, what is reached, and what ends one."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="not installed: pip install pymavlink (extra mavlink)")

from pymavlink.dialects.v20 import ardupilotmega as dialect

from ltv_mpc import config, references
from ltv_mpc.messages import Acknowledgement, Action, Authority, Command
from ltv_mpc.references.mission_items import DRIVEN
from services.edges.edge import Outgoing, Received
from services.edges.mavlink.lists import Mission, mission_of
from services.edges.mavlink.mission import WARNING, MissionFollower, Progress
from tests.foreign_plant.mavlink_flight import MavlinkFlight
from tests.services.edges.mavlink.items import ORIGIN, codec, item
from tests.services.edges.plans import plan

HERE = (0.0, 0.0)
NAV_CONDITION_DO = {
    number: entry.name
    for number, entry in dialect.enums["MAV_CMD"].items()
    if any(kind in entry.name for kind in ("_NAV_", "_CONDITION_", "_DO_"))
}


HOME = item(0, 16)


def mission(*items: Any, dives: bool = False, first: int = 1) -> Mission:
    found = mission_of([HOME, *items], ORIGIN, 0.5, HERE, dives=dives, first=first)
    assert found is not None
    return found


def read(toml: str) -> Any:
    return config.parse(config.loads(toml), references.Reference, source="mission")  # type: ignore[arg-type]


def numbers(found: Mission) -> list[int]:
    return [stop.number for stop in found.stops if stop.number]


# --- items -----------------------------------------------------------------------------------------------------------


def with_command(number: int) -> tuple[Any, ...]:
    """Return a mission with this command as its item 2."""
    parameters = {18: (1.0, 0.0, 5.0), 19: (20.0,), 93: (20.0,), 177: (1.0, 2.0), 178: (1.0, 0.7)}.get(number, ())
    second = item(2, number, *parameters, north_m=20.0, east_m=20.0)
    return item(1, 16, north_m=20.0), second, item(3, 16, east_m=40.0)


@pytest.mark.parametrize("dives", [False, True])
def test_each_command_is_driven_or_refused_by_number_and_name(dives: bool) -> None:
    """All NAV, CONDITION and DO commands that pymavlink knows."""
    driven = {number for number in DRIVEN if dives or number != 21}
    for number in driven:
        order = numbers(mission(*with_command(number), dives=dives))
        first = [1, 2] if number in (16, 17, 18, 19, 20, 21, 82) else [1, 1] if number == 177 else [1, 3]
        assert order[:2] == first, number
        assert (3 in order) is (number not in (17, 20)), number  # nothing is driven behind these
    for number in NAV_CONDITION_DO.keys() - driven:
        with pytest.raises(ValueError, match=rf"mission: item 2 {NAV_CONDITION_DO[number]} \({number}\)"):
            mission(*with_command(number), dives=dives)


def test_a_single_place_is_driven_at_the_speed_of_the_mission() -> None:
    """A point has no speed: the way begins where the vehicle is."""
    found = mission(item(1, 178, 1.0, 0.2), item(2, 16, north_m=30.0))
    way = read(found.toml)
    assert (way.speed_mps, len(way.waypoints), found.along_m) == (0.2, 2, [pytest.approx(30.0, abs=0.02)])


def test_a_dive_goes_to_the_depth_of_each_item_and_surfaces_to_land() -> None:
    """The places of ArduSub's own ``DiveMission``: three at 50 m, a circle and a landing place at 25 m."""
    found = mission(
        item(1, 16, east_m=-20.0, z=-50.0),
        item(2, 16, east_m=-60.0, z=-50.0),
        item(3, 18, 1.25, 0.0, 50.0, east_m=-120.0, z=-25.0),
        item(4, 21, 25.0, north_m=100.0, east_m=70.0, z=-25.0),
        dives=True,
    )
    assert numbers(found) == [1, 2, 3, 4]
    places, stops = np.array(found.places), found.stops
    assert [stop.place.depth_m for stop in stops] == [50.0, 50.0, *[25.0] * (len(stops) - 3), 0.0]
    circle = places[2:-2] - (0.0, -120.0)
    np.testing.assert_allclose(np.hypot(*circle.T), 50.0, atol=0.02)
    angle = np.unwrap(np.arctan2(circle[:, 1], circle[:, 0]))
    assert angle[0] == pytest.approx(0.5 * math.pi, abs=1e-3)  # it comes from the east
    assert angle[-1] - angle[0] == pytest.approx(2.5 * math.pi, abs=1e-3)
    np.testing.assert_allclose(places[-2:], [(100.0, 70.0)] * 2, atol=0.02)
    assert read(found.toml).path().depth[-2:].tolist() == [25.0, 0.0]


def test_a_negative_radius_is_counter_clockwise() -> None:
    found = mission(item(1, 18, 0.25, 0.0, -5.0, north_m=20.0), item(2, 16, east_m=60.0))
    np.testing.assert_allclose(np.array(found.places)[[0, -2]], [(15.0, 0.0), (20.0, 5.0)], atol=0.02)  # from the south


def test_two_items_at_one_place_are_a_wait_or_a_change_of_depth_there() -> None:
    found = mission(item(1, 16, north_m=20.0), item(2, 19, 9.0, north_m=20.0), item(3, 17, x=0, y=0))
    assert numbers(found) == [1, 2, 3]
    assert isinstance(read(found.toml), references.Point)  # at which it stays
    found = mission(item(1, 16, north_m=9.0), item(2, 19, 9.0, north_m=9.0), item(3, 16, east_m=9.0))
    assert read(found.toml).path().wait.tolist() == [9.0, 0.0]
    found = mission(item(1, 16, north_m=9.0, z=-2.0), item(2, 16, north_m=9.0, z=-7.0), dives=True)
    assert read(found.toml).path().depth.tolist() == [2.0, 7.0]


def test_jumps_repeat_and_a_delay_waits() -> None:
    items = (item(1, 93, 5.0), item(2, 16, north_m=20.0), item(3, 16, east_m=20.0), item(4, 177, 2.0, 2.0))
    found = mission(*items)
    assert numbers(found) == [2, 3, 2, 3, 2, 3]
    assert (found.places[0], found.stops[0].place.wait_s) == (HERE, 5.0)
    assert numbers(mission(*items, first=3)) == [3, 2, 3, 2, 3]
    assert mission_of([HOME], ORIGIN, 0.5, HERE, dives=False) is None


def test_items_that_are_not_reached_are_told() -> None:
    found = mission(
        item(1, 16, north_m=9.0), item(2, 20), item(3, 16, east_m=9.0), item(4, 93, 1.0, x=0, y=0), item(5, 82)
    )
    assert found.texts[-1] == "not reached, behind item 2: 3, 5"


@pytest.mark.parametrize(
    ("refused", "dives", "says"),
    [
        (item(2, 177, 1.0, -1.0), False, "not for ever"),
        (item(2, 177, 9.0, 1.0), False, "from 1 to 2"),
        (item(2, 177, 1.0, 5000.0), False, "makes more than 2000 steps"),
        (item(2, 178, 2.0, 0.3), True, r"type of speed 2 \(param 1\) must be 0 or 1"),
        (item(2, 19, -5.0), False, "cannot wait for -5 s"),
        (item(2, 178, 1.0, 0.0), False, "speed 0 m/s must be above 0"),
        (item(2, 18, 1.0), False, "needs turns .* and a radius"),
        (item(2, 18, 1.0, 0.0, math.inf), False, "needs turns"),
        (item(2, 18, 1e7, 0.0, 5.0), False, "needs more than 100,000 waypoints"),
        (item(2, 18, 1.0, 0.0, 1e30), False, "radius .* of at most 50000 m"),
        (item(2, 19, math.nan), False, "cannot wait for nan s"),
        (item(2, 19, 1e9), False, r"cannot wait for 1e\+09 s, more than 1e\+06 s"),
        (item(2, 178, 1.0, 25.0), False, "speed 25 m/s must be at most 20 m/s"),
        (item(2, 16, north_m=5.0, z=-2e4), True, "altitude -20000 m"),
        (item(2, 178, 1.0, math.inf), False, "speed inf m/s must be above 0, and finite"),
        (item(2, 93, math.inf), False, "needs seconds"),
        (item(2, 16, frame=1), False, "frame 1 must be global"),
        (item(2, 16, frame=5, z=-3.0), True, "relative to home"),
        (item(2, 16, z=2.0), True, "altitude 2 m"),
        (item(2, 16, x=100_000_000), False, "farther than 50 km"),
    ],
)
def test_an_item_that_cannot_be_driven_is_refused(refused: Any, dives: bool, says: str) -> None:
    with pytest.raises(ValueError, match=rf"mission: item 2 MAV_CMD_\w+ \(\d+\).*{says}"):
        mission(item(1, 16, north_m=20.0), refused, dives=dives)


# --- following -------------------------------------------------------------------------------------------------------


def followed(flight: MavlinkFlight, action: Action = Action.FOLLOW) -> list[Command]:
    return [one for one in flight.outputs if isinstance(one, Command) and one.action is action]


def reached_items(flight: MavlinkFlight) -> list[int]:
    """Collect the numbers of the items that the autopilot is told to be reached."""
    reached: list[int] = []
    send = flight.send

    def listen(way: str, data: bytes) -> None:
        message = codec().decode(data) if way == "to autopilot" else None
        if message is not None and message.get_type() == "MISSION_ITEM_REACHED":
            reached.append(message.seq)
        send(way, data)

    flight.send = listen  # type: ignore[method-assign]
    return reached


def upload(flight: MavlinkFlight, *items: Any) -> None:
    """Send a mission as a ground station, over its own link."""
    make, station = flight.station, flight.from_station
    station(make.mission_count_encode(1, 1, len(items), 0))
    for one in items:
        one.target_system, one.target_component = 1, 1
        station(one)


LEGS = (
    HOME,
    item(1, 178, 1.0, 0.8),
    item(2, 16, north_m=8.0),
    item(3, 19, 10.0, north_m=8.0, east_m=8.0),
    item(4, 178, 1.0, 0.4),
    item(5, 16, east_m=8.0),
)


def test_a_mission_is_driven_at_its_speeds_and_each_item_is_reported() -> None:
    flight = MavlinkFlight()
    reached = reached_items(flight)
    flight.relays = True
    flight.fly(3.0)
    upload(flight, *LEGS)
    flight.arm()
    flight.command(action="arm")
    flight.fly(15.0)
    while len(reached) < 2:
        flight.fly(0.5)
        assert len(flight.track) < 10_000
    assert reached == [2, 3]
    assert np.hypot(*(flight.fly(7.0)[-250:] - (8.0, 8.0)).T).max() < 1.0  # it waits
    slow = flight.fly(21.0)
    assert np.hypot(*np.diff(slow[-250:], axis=0).T).mean() / 0.02 == pytest.approx(0.4, abs=0.1)
    flight.fly(25.0)
    assert reached == [2, 3, 5]
    assert len(followed(flight)) == 1
    assert np.hypot(*(flight.track[-1] - (0.0, 8.0))) < 0.5
    texts = [text for text in flight.autopilot.log if "m/s" in text]
    assert texts[0].startswith("LTV-MPC: 2: 50.2000")
    assert texts[1].endswith("at 0.8 m/s, waits 10 s")
    assert texts[2].endswith("at 0.4 m/s, then holds")


def test_a_plan_that_is_older_than_the_reply_says_nothing_of_the_mission() -> None:
    """It is of the reference before, at whose end the vehicle may be."""
    progress = Progress(mission(item(1, 16, north_m=10.0)))
    arrived = msgspec.structs.replace(plan(0), arrived=True)
    assert progress.follow(arrived) == []
    progress.accept(300)
    assert progress.follow(arrived) == []
    later = msgspec.structs.replace(arrived, cycle_t_ns=300)
    assert progress.follow(later) == [1]
    assert progress.follow(later) == []


def sent(follower: MissionFollower, north_m: float, now_us: int) -> None:
    """Let the autopilot send a mission of one place, twice."""
    for at_us in (now_us, now_us + 2_000_000):
        follower.take("MISSION_COUNT", codec().make.mission_count_encode(255, 191, 2), at_us, by_station=True)
        for one in (HOME, item(1, 16, north_m=north_m)):
            follower.take("MISSION_ITEM_INT", one, at_us, by_station=True)


def test_a_mission_waits_for_its_origin_and_says_so_and_a_late_reply_to_it_is_none_to_the_next_one() -> None:
    numbers = iter(range(1, 9))
    follower = MissionFollower(0.5, lambda: next(numbers), dives=False)
    follower.here = HERE
    sent(follower, 10.0, 0)
    assert list(follower.texts) == [(WARNING, "mission waits: no GPS_GLOBAL_ORIGIN yet")]
    assert follower.commands() == ()
    origin = codec().make.gps_global_origin_encode(502000000, -51000000, 0)
    follower.take("GPS_GLOBAL_ORIGIN", origin, 3_000_000, by_station=True)
    (first,) = follower.commands()
    sent(follower, 20.0, 10_000_000)
    reply = Acknowledgement(t_ns=0, command_id=1, accepted=True, authority=Authority.CONTROLLER, why="")
    assert follower.acknowledged(reply) is None
    (second,) = follower.commands()
    assert second.reference_toml != first.reference_toml


PLACES = (HOME, item(1, 16, north_m=10.0), item(2, 16, north_m=10.0, east_m=7.0))


def test_the_same_mission_sent_again_begins_again_and_clearing_it_holds() -> None:
    flight = MavlinkFlight()
    flight.fly(3.0)
    upload(flight, *PLACES)
    flight.fly(25.0)
    assert len(followed(flight)) == 1
    upload(flight, *PLACES)
    flight.fly(5.0)
    assert len(followed(flight)) == 2
    flight.from_station(flight.station.mission_set_current_encode(1, 1, 2))
    flight.fly(2.0)
    way = read(followed(flight)[-1].reference_toml)
    assert len(followed(flight)) == 3
    assert way.waypoints[-1].longitude_deg == pytest.approx(-5.0999, abs=1e-5)
    assert way.waypoints[0].north_m == pytest.approx(flight.hull.x[0], abs=1.0)  # straight to item 2
    flight.arm(mode=10)  # in AUTO the autopilot goes on by itself
    flight.fly(1.2)
    flight.from_station(flight.station.mission_set_current_encode(1, 1, 1))
    flight.fly(2.0)
    flight.arm(mode=0)
    flight.fly(1.2)
    for current, sent_s in ((0, {}), (2, {42: 0.0})):  # restarts, with another item at once or after a second
        flight.fly(6.0)
        flight.autopilot.ms, flight.autopilot.current, flight.autopilot.sent_s = 0, current, sent_s
        flight.fly(3.0)
    assert flight.edge.navigation.restarts == 2
    assert len(followed(flight)) == 3
    flight.from_station(flight.station.mission_clear_all_encode(1, 1, 0))
    flight.fly(25.0)
    assert len(followed(flight)) == 3
    assert len(followed(flight, Action.HOLD)) == 1
    assert flight.autopilot.log[-1] == "LTV-MPC: mission cleared: holds"


@pytest.mark.parametrize("accepted", [True, False])
def test_an_accepted_command_of_an_operator_ends_the_mission(accepted: bool) -> None:
    """Else the mission would go on when the vehicle has arrived at the operator's point."""
    flight = MavlinkFlight()
    reached = reached_items(flight)
    flight.fly(3.0)
    upload(flight, HOME, item(1, 19, 1.0, north_m=10.0), PLACES[2])
    flight.fly(15.0)
    edge, now_us = flight.edge, flight.host_us
    list(edge.take(Command(command_id=77, action=Action.HOLD), now_us))
    reply = Acknowledgement(t_ns=0, command_id=77, accepted=accepted, authority=Authority.CONTROLLER, why="")
    list(edge.take(reply, now_us))
    arrived = msgspec.structs.replace(flight.plans[-1], arrived=True)
    flight.pass_on(edge.take(arrived, now_us))
    flight.fly(2.0)
    assert reached == ([] if accepted else [1, 2])
    assert ("LTV-MPC: mission ended by a command of the operator" in flight.autopilot.log) is accepted


def test_a_refused_mission_leaves_the_one_in_force() -> None:
    flight = MavlinkFlight()
    reached = reached_items(flight)
    flight.fly(3.0)
    flight.autopilot.lists[0] = list(PLACES)
    flight.fly(15.0)
    flight.autopilot.lists[0] = [*PLACES, item(3, 183, 9.0, 1500.0)]
    flight.fly(15.0)
    assert flight.autopilot.log[-1] == "LTV-MPC: mission: item 3 MAV_CMD_DO_SET_SERVO (183) is not driven here"
    arrived = msgspec.structs.replace(flight.plans[-1], arrived=True)
    for _ in range(3):
        flight.pass_on(flight.edge.take(arrived, flight.host_us))
    assert reached == [1, 2]  # once
    assert len(followed(flight)) == 1
    flight.rejection = "too fast"
    flight.autopilot.lists[0] = [HOME, item(1, 16, north_m=30.0)]
    flight.fly(15.0)
    assert flight.autopilot.log[-1] == "LTV-MPC: mission rejected: too fast"
    flight.pass_on(flight.edge.take(arrived, flight.host_us))
    assert reached == [1, 2]  # another reference is followed


def test_answers_to_another_station_are_not_taken() -> None:
    """A router passes them on: the ground station has the same system number."""
    flight = MavlinkFlight()
    flight.fly(15.0)
    c = codec()
    for component, asked in ((190, False), (191, True)):
        count = c.make.mission_count_encode(255, component, 3, 0)
        flight.edge.receive(Received("", c.encode(count), b"", flight.host_us))
        sent = [c.decode(one.payload) for one in flight.edge.step(flight.host_us) if isinstance(one, Outgoing)]
        assert any(one.get_type() == "MISSION_REQUEST_INT" for one in sent) is asked
