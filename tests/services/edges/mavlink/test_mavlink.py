"""Edge to MAVLink: the rules of ArduPilot for overrides, navigation, mission, versions and signatures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="not installed: pip install pymavlink (extra mavlink)")

from pymavlink.dialects.v20 import ardupilotmega as dialect

from ltv_mpc import config
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import Action, Applied, Command, Estimate, Health
from ltv_mpc.vehicle.parameters import Vehicle
from services.edges.edge import Outgoing, Received, Refused
from services.edges.mavlink.actuation import Overrides, channels, pwm_us
from services.edges.mavlink.autopilot import Kind
from services.edges.mavlink.codec import frames_of
from services.edges.mavlink.edge import MavlinkEdge, Settings
from services.edges.mavlink.lists import fence_of
from services.edges.mavlink.navigation import Accuracy, Navigation
from tests.foreign_plant.flight import farthest_m
from tests.foreign_plant.mavlink_flight import EXAMPLE, MavlinkFlight, vehicle
from tests.services.controller_status import status
from tests.services.edges.mavlink.items import ORIGIN, codec, item, square

BOAT = "bluerobotics-boat"
KEY = bytes(range(32))


# --- thrust ----------------------------------------------------------------------------------------------------------


THRUSTS = [
    (0.0, 1500),
    (51.5, 1900),
    (-39.9, 1100),
    (60.0, 1900),
    (4.25, 1576),
    (-6.6, 1390),
    (1e-6, 1528),
    (-1e-6, 1472),
]


@pytest.mark.parametrize(("thrust_N", "us"), THRUSTS)
def test_a_thrust_is_the_pwm_of_the_published_curve_and_steps_over_the_dead_band(thrust_N: float, us: float) -> None:
    port = Vehicle.load(BOAT).thruster.port
    assert pwm_us(port, thrust_N) == pytest.approx(us, abs=0.01)
    mirrored = tuple(3000.0 - one for one in reversed(port.pwm_us))  # of a motor that turns the other way
    other = msgspec.structs.replace(port, pwm_us=mirrored, pwm_N=tuple(reversed(port.pwm_N)))
    assert pwm_us(other, thrust_N) == pytest.approx(3000.0 - us, abs=0.01)


def test_the_mix_is_the_inverse_of_that_of_the_autopilot() -> None:
    """Its throttle has whole percent, 4 us; its own mix then gives the thrusts of the table."""
    autopilot, boat = EXAMPLE.Autopilot(EXAMPLE.Boat()), Vehicle.load(BOAT)
    autopilot.armed, autopilot.mode = True, 0
    rng = np.random.default_rng(0)
    for thrust_N in rng.uniform(-39.0, 51.0, size=(200, 2)):
        wanted = channels(boat, Kind.ROVER, np.array([*thrust_N, 0.0]))
        assert set(wanted) == {1, 3}
        autopilot.overrides = {channel: (us, autopilot.now_s) for channel, us in wanted.items()}
        np.testing.assert_allclose(autopilot.thrusts(), thrust_N, atol=1.3)


def test_a_submarine_has_forward_yaw_and_vertical() -> None:
    of = Vehicle.load("paper")
    table = {"pwm_us": (1100.0, 1500.0, 1900.0), "pwm_N": (-10.0, 0.0, 10.0)}
    port, starboard, vertical = (msgspec.structs.replace(one, **table) for one in of.thrusters)
    thrusters = msgspec.structs.replace(of.thruster, port=port, starboard=starboard, vertical=vertical)
    of = msgspec.structs.replace(of, thruster=thrusters)
    assert channels(of, Kind.SUB, np.array([10.0, 0.0, 5.0])) == {3: 1300, 4: 1700, 5: 1700}


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        ({"pwm_us": (1100.0, 1900.0)}, "same length"),
        ({"pwm_us": (1900.0, 1100.0), "pwm_N": (-1.0, 1.0)}, "must increase"),
        ({"pwm_us": (1100.0, 1500.0, 1900.0), "pwm_N": (-1.0, 2.0, 1.0)}, "rise, or fall"),
        ({"pwm_us": (1100.0, 1900.0), "pwm_N": (0.0, 1.0)}, "both signs"),
    ],
)
def test_a_table_without_an_inverse_is_rejected(table: dict[str, Any], problem: str) -> None:
    fields = msgspec.structs.asdict(Vehicle.load(BOAT).thruster.port)
    with pytest.raises(ValueError, match=problem):
        type(Vehicle.load(BOAT).thruster.port)(**(fields | {"pwm_us": (), "pwm_N": ()} | table))


# --- may the edge drive? ---------------------------------------------------------------------------------------------


def driving(**link: Any) -> MavlinkFlight:
    flight = MavlinkFlight(**link)
    flight.fly(3.0)
    flight.arm()
    flight.command(action="arm")
    flight.fly(4.0)
    assert not flight.edge.idle
    assert flight.autopilot.overrides
    assert "LTV-MPC: driving" in flight.autopilot.log
    return flight


@pytest.mark.parametrize("link", [{"v1": True}, {"key": KEY}])
def test_an_autopilot_of_version_1_or_that_signs_is_driven(link: dict[str, Any]) -> None:
    assert driving(**link).edge.refused == 0


def test_without_the_ground_station_it_lets_go_and_does_not_stand_for_it() -> None:
    flight = driving()
    flight.station_beats = False
    flight.fly(3.9)
    assert not flight.edge.idle
    while not flight.edge.idle:
        flight.fly(0.02)
    flight.fly(0.1)
    assert {us for us, _ in flight.autopilot.overrides.values()} == {1500}
    flight.fly(8.0)
    assert flight.autopilot.failsafe  # the edge has not stood for the ground station


def other_station(flight: MavlinkFlight) -> None:
    """Replace the ground station by another one, which does not stand for it."""
    flight.station_beats = False
    other = dialect.MAVLink(None, srcSystem=254, srcComponent=190)
    for _ in range(8):
        beat = other.heartbeat_encode(6, 8, 0, 0, 4)
        flight.deliver(flight.autopilot.receive(bytes(beat.pack(other)), 1))
        flight.fly(1.0)


def disarm(flight: MavlinkFlight) -> None:
    flight.from_station(flight.station.command_long_encode(1, 1, 400, 0, 0.0, 0.0, 0, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        (lambda flight: flight.arm(mode=4), "autopilot in mode HOLD"),
        (lambda flight: flight.arm(mode=10), "autopilot in mode AUTO"),
        (disarm, "autopilot disarmed"),
        (lambda flight: setattr(flight.autopilot, "failsafe", True), "autopilot in failsafe"),
        (lambda flight: flight.kill_controller(), "no plan"),
        (lambda flight: flight.command(action="stop"), "controller stopped"),
        (other_station, "ground station 255 lost"),
    ],
)
def test_what_ends_it_is_told_and_the_channels_are_let_go(cause: Callable[[MavlinkFlight], None], text: str) -> None:
    flight = driving()
    cause(flight)
    flight.fly(1.1)  # the autopilot's heartbeats come once a second
    flight.autopilot.actuated_while_disarmed = 0
    flight.fly(6.9)
    assert flight.autopilot.overrides == {}
    assert not flight.edge.overrides.acts(flight.host_us)
    assert any(line.startswith(f"LTV-MPC: not driving: {text};") for line in flight.autopilot.log)
    assert flight.autopilot.actuated_while_disarmed == 0


def test_a_lost_autopilot_gets_nothing_more_and_a_process_that_stops_lets_go() -> None:
    flight = driving()
    rows = [frame for frame in flight.edge.release(flight.host_us) if isinstance(frame, Outgoing)]
    for frame in rows[:-1]:  # the last one is lost
        flight.autopilot.receive(frame.payload, 0)
    assert flight.autopilot.overrides == {}


def test_while_it_has_released_nothing_is_learned_and_then_the_boat_does_not_lunge() -> None:
    """The target is 5 m ahead. Without reports of what acts it would learn half a metre a second of other current."""
    flight = MavlinkFlight()
    flight.hull.plant.outside[:2] = 0.0, 0.3  # current north and east
    flight.fly(3.0)
    flight.arm()
    flight.command(action="arm")
    flight.fly(30.0)
    heading = flight.autopilot.boat.attitude()[2]
    flight.hull.x[0] -= 5.0 * math.cos(heading)
    flight.hull.x[1] -= 5.0 * math.sin(heading)
    observer = flight.node.controller.observer
    believed = observer.bias_mps
    flight.arm(mode=4)
    flight.fly(15.0)
    np.testing.assert_allclose(observer.bias_mps, believed, atol=0.005)
    why = "not driving: autopilot in mode HOLD; set MANUAL"
    assert flight.plans[-1].health_why == why
    assert f"LTV-MPC: {why}" in flight.autopilot.log
    flight.arm(mode=0)
    track = flight.fly(30.0)
    way = -track[0] / np.linalg.norm(track[0])
    assert (track @ way).max() < 0.3
    assert farthest_m(track[-500:]) < 0.3
    np.testing.assert_allclose(observer.bias_mps, believed, atol=0.05)
    assert (flight.plans[-1].health, flight.plans[-1].health_why) == (Health.NOMINAL, "")


def test_what_acts_is_the_command_of_the_override_and_zero_once_it_is_released() -> None:
    flight = driving()
    edge, now_us = flight.edge, flight.host_us
    outputs = [one for k in range(1, 31) for one in edge.step(now_us + 50_000 * k)]
    reports = [one for one in outputs if isinstance(one, Applied)]
    assert 14 <= len(reports) <= 16  # ten in a second
    np.testing.assert_allclose(reports[-1].command_N, edge.plans.thrust_N(reports[-1].t_ns))
    assert reports[-1].plan_cycle_t_ns == edge.plans.newest.cycle_t_ns
    (released, *_) = edge.release(now_us + 1_510_000)
    assert isinstance(released, Applied)
    assert (released.command_N, released.why) == ((0.0, 0.0, 0.0), "the edge has stopped")


def test_while_disarmed_nothing_but_the_release_is_sent() -> None:
    overrides = Overrides(vehicle())
    thrust = np.ones(3)
    assert overrides.step(Kind.ROVER, thrust, False, 0) is None
    assert overrides.step(Kind.ROVER, thrust, True, 0) is not None
    row = overrides.step(Kind.ROVER, thrust, False, 40_000)
    assert row == [0, 65535, 0, 65535, 65535, 65535, 65535, 65535]


def test_an_autopilot_that_is_not_ardupilot_is_refused() -> None:
    edge, px4 = MavlinkEdge(1, Settings(vehicle=vehicle()), codec(255, 191)), codec()
    edge.receive(Received("", px4.encode(px4.make.heartbeat_encode(11, 12, 0, 0, 4)), b"", 0))
    assert edge.refused == 1
    assert "must be ArduPilot" in edge.reason


# --- navigation ------------------------------------------------------------------------------------------------------


def attitude(ms: int, yaw: float, rate: float = 0.0) -> Any:
    return codec().make.attitude_encode(ms, 0.0, 0.0, yaw, 0.0, 0.0, rate)


def position(ms: int, x: float = 0.0, vx: float = 0.0) -> Any:
    return codec().make.local_position_ned_encode(ms, x, 2.0, 3.0, vx, 0.5, 0.1)


def test_an_estimate_has_the_attitude_between_two_samples_on_the_shorter_way() -> None:
    navigation = Navigation(Accuracy(), dives=True)
    assert list(navigation.position(position(950, 7.0, 1.5))) == []  # before the first attitude: it never has one
    assert list(navigation.attitude(attitude(1000, math.pi - 0.05, 1.0))) == []
    assert list(navigation.position(position(1050, 7.0, 1.5))) == []  # the attitude behind it is to come
    (estimate,) = navigation.attitude(attitude(1100, -math.pi + 0.05, 1.0))
    assert isinstance(estimate, Estimate)
    assert estimate.t_ns == 1_050_000_000
    assert abs(estimate.heading_rad) == pytest.approx(math.pi)
    assert (estimate.north_m, estimate.east_m, estimate.depth_m) == pytest.approx((7.0, 2.0, 3.0))
    assert (estimate.velocity_north_mps, estimate.velocity_down_mps) == pytest.approx((1.5, 0.1))
    assert estimate.covariance is not None
    assert estimate.covariance[4, 4] == pytest.approx(0.05**2)


def test_the_time_base_is_that_of_the_answers_to_its_own_requests() -> None:
    """Stamps arrive 200 ms late, answers 10 ms: the answers are closer to the autopilot's time."""
    edge, autopilot = MavlinkEdge(1, Settings(vehicle=vehicle()), codec(255, 191)), codec()

    def receive(message: Any, now_us: int) -> None:
        edge.receive(Received("", autopilot.encode(message), b"", now_us))

    receive(autopilot.make.heartbeat_encode(11, 3, 0, 0, 4), 1_000_000)
    receive(autopilot.make.system_time_encode(0, 7_800), 1_000_000)  # the autopilot is at 8 s
    assert edge.clock.read(1_000_000) == 7_800_000_000
    receive(autopilot.make.timesync_encode(0, 1_000_000_000), 1_000_000)  # a request of the autopilot, no fast answer
    assert edge.clock.read(1_000_000) == 7_800_000_000
    sent = [codec().decode(frame.payload) for frame in edge.step(2_000_000) if isinstance(frame, Outgoing)]
    (request,) = (message for message in sent if message.get_type() == "TIMESYNC")
    assert request.tc1 == 0
    receive(autopilot.make.timesync_encode(9_005_000_000, request.ts1), 2_010_000)
    assert edge.clock.read(2_010_000) == 9_010_000_000
    assert edge.refused == 0


def test_a_new_autopilot_is_asked_for_its_messages_at_once() -> None:
    edge, autopilot = MavlinkEdge(1, Settings(vehicle=vehicle()), codec(255, 191)), codec()
    list(edge.step(1_000_000))
    edge.receive(Received("", autopilot.encode(autopilot.make.heartbeat_encode(11, 3, 0, 0, 4)), b"", 1_010_000))
    sent = [codec().decode(frame.payload) for frame in edge.step(1_050_000) if isinstance(frame, Outgoing)]
    assert {30, 32} <= {message.param1 for message in sent if message.get_type() == "COMMAND_LONG"}


def test_late_and_repeated_samples_are_left_out_and_a_restart_is_not() -> None:
    navigation = Navigation(Accuracy(), dives=False)
    list(navigation.attitude(attitude(10_000, 0.0)))
    list(navigation.attitude(attitude(10_100, 0.1)))
    assert len(list(navigation.position(position(10_050)))) == 1
    assert list(navigation.position(position(10_050))) == []
    assert list(navigation.position(position(10_000))) == []
    list(navigation.attitude(attitude(100, 0.0)))
    list(navigation.position(position(150)))
    (estimate,) = navigation.attitude(attitude(200, 0.0))
    assert (estimate.t_ns, estimate.depth_m) == (150_000_000, None)
    assert navigation.restarts >= 1


def test_a_reset_of_the_filter_is_counted_and_nothing_is_interpolated_across_it() -> None:
    navigation = Navigation(Accuracy(), dives=False)
    list(navigation.attitude(attitude(1000, 0.0)))
    list(navigation.position(position(1050)))
    assert list(navigation.attitude(attitude(1100, 0.8))) == []  # the heading has jumped
    assert navigation.resets == 1
    list(navigation.position(position(1150)))
    assert len(list(navigation.attitude(attitude(1200, 0.8)))) == 1
    list(navigation.position(position(1250, 4.0)))  # the position has jumped
    assert navigation.resets == 2


UNKNOWN = [math.nan] * 21
EAST = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def odometry(frame: int = 1, child: int = 12, q: Sequence[float] = EAST, reset: int = 0, **given: list[float]) -> Any:
    """Return an ODOMETRY that goes ahead at 1 m/s and turns by 0.2 rad/s; ``pose`` and ``twist`` are covariances."""
    covariances = given.get("pose", UNKNOWN), given.get("twist", UNKNOWN)
    motion = (1.0, 0.0, 0.0, 0.0, 0.0, 0.2)
    return codec().make.odometry_encode(5_000_000, frame, child, 1.0, 2.0, 0.0, q, *motion, *covariances, reset)


def triangle(entries: dict[tuple[int, int], float]) -> list[float]:
    """Return the 21 values of an upper triangle."""
    return [entries.get((row, column), 0.0) for row in range(6) for column in range(row, 6)]


def test_odometry_has_its_own_attitude_and_excludes_positions() -> None:
    navigation = Navigation(Accuracy(), dives=False)
    (estimate,) = navigation.odometry(odometry())
    assert estimate.heading_rad == pytest.approx(math.pi / 2)
    assert (estimate.velocity_north_mps, estimate.velocity_east_mps) == pytest.approx((0.0, 1.0), abs=1e-9)
    assert (estimate.yaw_rate_radps, estimate.t_ns) == (pytest.approx(0.2), 5_000_000_000)
    np.testing.assert_allclose(estimate.covariance, Accuracy().covariance)
    with pytest.raises(Refused, match="odometry is in use"):
        navigation.position(position(6000))
    list(navigation.odometry(odometry(reset=1)))
    assert navigation.resets == 1
    for broken in ({"frame": 8}, {"child": 8}, {"q": (0.0,) * 4}, {"q": (math.nan, 0.0, 0.0, 1.0)}):
        with pytest.raises(Refused):
            navigation.odometry(odometry(**broken))
    with pytest.raises(Refused, match="pose covariance"):
        navigation.odometry(odometry(pose=[1.0, *UNKNOWN[1:]]))


def test_the_covariances_of_odometry_are_used_as_far_as_they_are_known() -> None:
    """Heading east at 1 m/s: surge is the velocity east, and a heading too far to starboard has it go to the south."""
    navigation = Navigation(Accuracy(), dives=False)
    pose = triangle({(0, 0): 4.0, (0, 1): 1.0, (1, 1): 9.0, (5, 5): 0.04})
    (known,) = navigation.odometry(odometry(pose=pose, twist=triangle({(0, 0): 0.25, (5, 5): 0.01})))
    expected = np.diag([4.0, 9.0, 0.04, 0.25, 0.04, 0.01])
    expected[0, 1] = expected[1, 0] = 1.0
    expected[2, 4] = expected[4, 2] = -0.04
    np.testing.assert_allclose(known.covariance, expected, atol=1e-6)
    (half_known,) = navigation.odometry(odometry(pose=pose))
    assert half_known.covariance is not None
    assert half_known.covariance[0, 0] == pytest.approx(4.0)
    assert half_known.covariance[3, 3] == pytest.approx(Accuracy().velocity_mps ** 2)


def test_a_filter_without_a_position_gives_no_estimate() -> None:
    flight = MavlinkFlight()
    flight.fly(3.0)
    flight.autopilot.intervals[193] = 0.0
    flags = flight.autopilot.mav.ekf_status_report_encode(128, 0, 0, 0, 0, 0)
    flight.edge.receive(Received("", bytes(flags.pack(flight.autopilot.mav)), b"", flight.host_us))
    flight.fly(1.0)
    assert flight.edge.reason == "position: the EKF has none"


# --- fence ----


def test_the_items_of_a_fence_are_its_zones() -> None:
    items = [
        item(0, 5000),  # the point to return to is no zone
        *square(5001, 1),
        *square(5002, 5, side_m=10.0),
        item(9, 5003, 200.0, 1.0),  # of another group, in one of which the vehicle has to be
        item(10, 5004, 3.0, north_m=33.0),
    ]
    fence = config.parse(config.loads(fence_of(items, ORIGIN)), Fence, source="fence")
    area, wreck, buoy = fence.zones()
    assert (area.keep_in, wreck.keep_in, buoy.keep_in) == (True, False, False)
    assert wreck.vertices_m[0] == pytest.approx((-5.0, -5.0), abs=0.1)
    assert np.linalg.norm(area.vertices_m, axis=1) == pytest.approx(200.0, abs=0.01)  # the square is in it
    assert (buoy.radius_m, float(buoy.vertices_m[0, 0])) == (3.0, pytest.approx(33.0, abs=0.1))
    assert fence_of([item(0, 5000)], ORIGIN) == ""


@pytest.mark.parametrize(
    ("items", "says"),
    [
        ([*square(5001)[:3], *square(5002, 3)], "3 of 4 vertices"),
        ([item(0, 5004, math.nan)], r"item 0 \w+ \(5004\) radius"),
        ([item(0, 5003, -1.0)], r"item 0 \w+ \(5003\) radius"),
        ([square(5001)[at] for at in (0, 2, 1, 3)], "meet"),
        ([item(at, 5002, 40.0, north_m=at, east_m=at**2 / 100.0) for at in range(40)] * 80, "fence_toml"),
    ],
)
def test_a_fence_that_is_no_area_is_refused(items: list[Any], says: str) -> None:
    with pytest.raises(Refused, match=says):
        fence_of(items, ORIGIN)


def test_the_fence_of_the_autopilot_is_kept_a_refused_one_is_not_and_its_end_removes_it() -> None:
    flight = MavlinkFlight()
    flight.fly(3.0)
    flight.autopilot.lists[1] = square(5001)
    flight.fly(12.0)
    flight.autopilot.lists[1] = square(5001)[:3]
    flight.fly(12.0)
    assert flight.autopilot.log[-1] == "LTV-MPC: fence: the last polygon has 3 of 4 vertices"
    flight.autopilot.lists[1] = []
    flight.fly(12.0)
    kept, removed = (output for output in flight.outputs if isinstance(output, Command))
    assert (kept.action, removed.action) == (Action.FENCE, Action.FENCE)
    assert "keep_in" in kept.fence_toml
    assert removed.fence_toml == ""


def test_the_distance_from_the_reference_is_a_named_value() -> None:
    edge = MavlinkEdge(1, Settings(vehicle=vehicle()), codec(255, 191))
    edge.clock.update(9_000_000_000, 1_000_000)
    (frame,) = edge.take(status(error_m=1.25), 1_500_000)
    assert isinstance(frame, Outgoing)
    value = codec().decode(frame.payload)
    assert (value.get_type(), value.name, value.value) == ("NAMED_VALUE_FLOAT", "mpc_err", 1.25)
    assert value.time_boot_ms == 9_500
    assert list(edge.take(status(error_m=None), 1_500_000)) == []


# --- frames ----------------------------------------------------------------------------------------------------------


def test_a_datagram_of_several_frames_of_both_versions_is_read_frame_by_frame() -> None:
    c = codec()
    one, two = c.encode(attitude(1, 0.0)), bytes(position(2).pack(c.make, force_mavlink1=True))
    assert list(frames_of(one + two + b"rest")) == [one, two, b"rest"]
    assert codec().decode(two).get_type() == "LOCAL_POSITION_NED"
    edge = MavlinkEdge(1, Settings(vehicle=vehicle()), codec(255, 191))
    edge.receive(Received("", one + two + b"rest", b"", 0))
    assert (edge.accepted, edge.refused) == (2, 1)
