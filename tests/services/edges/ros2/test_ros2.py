"""Bridge to ROS 2: bytes by hand, conversion of frames and back, covariance by sampling, and the process on a bus."""

from __future__ import annotations

import itertools
import math
import struct
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ltv_mpc.messages import Estimate
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.session import ForeignReceiver, open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, decode, encode
from services.edges.edge import Refused
from services.edges.ros2 import cdr
from services.edges.ros2.middleware import Bridge
from services.edges.ros2.odometry import estimate_of
from services.edges.ros2.topics import IN, TABLE
from services.processes.ros2 import FROM_PUBLISHER, RosLink
from services.runtime.stopping import StopRequest
from tests.services.edges.plans import plan
from tests.system.alone import CLI, started
from tests.waiting import until

SECOND_NS = 1_000_000_000
ODOMETRY = "nav_msgs/msg/Odometry"
STAMP = (1_700_000_000, 250_000_000)


class Cdr:
    """CDR by its rules: each number at a multiple of its own size behind the header, strings with their NUL."""

    def __init__(self, order: str = "<") -> None:
        self.order = order
        self.body = b""

    def number(self, kind: str, value: float) -> Cdr:
        size = struct.calcsize(kind)
        self.body += bytes(-len(self.body) % size) + struct.pack(self.order + kind, value)
        return self

    def text(self, value: str) -> Cdr:
        raw = value.encode() + b"\0"
        self.number("I", len(raw))
        self.body += raw
        return self

    def payload(self) -> bytes:
        return (b"\0\1\0\0" if self.order == "<" else b"\0\0\0\0") + self.body


def odometry(order: str = "<", stamp: tuple[int, int] = STAMP, **fields: Any) -> bytes:
    """Encode an Odometry by hand: stamp, frame, child frame, pose, its covariance, twist, its covariance."""
    message = Cdr(order).number("i", stamp[0]).number("I", stamp[1])
    message.text(fields.get("frame", "odom")).text(fields.get("child", "base_link"))
    yaw = fields.get("yaw", 0.0)
    blocks = {"position": np.zeros(3), "quaternion": (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))}
    blocks |= {"pose_covariance": np.zeros((6, 6)), "linear": np.zeros(3), "angular": np.zeros(3)}
    blocks["twist_covariance"] = np.zeros((6, 6))
    for name, default in blocks.items():
        for value in np.ravel(fields.get(name, default)):
            message.number("d", value)
    return message.payload()


def estimate(order: str = "<", **fields: Any) -> Estimate:
    return estimate_of(cdr.decode(odometry(order, **fields), ODOMETRY))


# --- bytes -----------------------------------------------------------------------------------------------------------


def test_a_force_is_a_float64_message_byte_for_byte() -> None:
    assert cdr.encode(cdr.make("std_msgs/msg/Float64", data=-62.5)) == bytes.fromhex("00010000" + "0000000000404fc0")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("frame", ["", "o", "od", "odo", "odom"])
def test_an_odometry_message_is_read_in_either_byte_order_with_names_of_any_length(order: str, frame: str) -> None:
    read = estimate(order, position=(3.0, 4.0, -5.0), linear=(1.0, 0.0, 0.0), frame=frame)
    assert read.t_ns == 1_700_000_000_250_000_000
    assert (read.north_m, read.east_m, read.depth_m) == (4.0, 3.0, 5.0)
    assert (read.heading_rad, read.velocity_east_mps) == (math.pi / 2, 1.0)  # yaw 0 is east


@pytest.mark.parametrize("payload", [b"", b"\0\1\0\0", b"\0\7\0\0" + bytes(720), odometry()[:-9], bytes(300_000)])
def test_what_is_no_odometry_is_refused(payload: bytes) -> None:
    with pytest.raises(Refused):
        cdr.decode(payload, ODOMETRY)


# --- frames ----------------------------------------------------------------------------------------------------------


finite = st.floats(-100, 100)


@given(st.tuples(finite, finite, finite), st.floats(-math.pi, math.pi), st.tuples(finite, finite, finite), finite)
def test_there_and_back_again_is_where_it_began(position, yaw, linear, yaw_rate) -> None:
    """Level; the way back is written down from the picture, not from the code."""
    read = estimate(position=position, yaw=yaw, linear=linear, angular=(0.0, 0.0, yaw_rate))
    assert read.depth_m is not None
    assert read.velocity_down_mps is not None
    assert (read.east_m, read.north_m, -read.depth_m) == pytest.approx(position)
    back = math.pi / 2 - read.heading_rad
    assert math.remainder(back - yaw, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    cos, sin = math.cos(read.heading_rad), math.sin(read.heading_rad)
    ahead = read.velocity_north_mps * cos + read.velocity_east_mps * sin
    starboard = read.velocity_east_mps * cos - read.velocity_north_mps * sin
    assert (ahead, -starboard, -read.velocity_down_mps) == pytest.approx(linear, abs=1e-9)
    assert -read.yaw_rate_radps == pytest.approx(yaw_rate)


def test_the_covariance_is_that_of_samples_drawn_from_the_messages_own() -> None:
    rng = np.random.default_rng(1)
    q = Rotation.from_euler("xyz", (0.3, -0.25, 1.3)).as_quat()
    mean = {"position": np.array([5.0, -7.0, -9.0]), "linear": np.array([1.2, -0.4, 0.3])}
    rates = np.array([0.05, -0.1, 0.2])
    a, b = (rng.normal(size=(6, 6)) * 0.005 for _ in range(2))
    pose, twist = a @ a.T, b @ b.T
    claimed = estimate(**mean, quaternion=q, angular=rates, pose_covariance=pose, twist_covariance=twist).covariance
    drawn = []
    errors = (rng.multivariate_normal(np.zeros(6), covariance, 4000) for covariance in (pose, twist))
    for p, t in zip(*errors, strict=True):
        e = estimate(
            position=mean["position"] + p[:3],
            quaternion=(Rotation.from_rotvec(p[3:]) * Rotation.from_quat(q)).as_quat(),
            linear=mean["linear"] + t[:3],
            angular=rates + t[3:],
        )
        drawn.append((e.north_m, e.east_m, e.velocity_north_mps, e.velocity_east_mps, e.heading_rad, e.yaw_rate_radps))
    found = np.cov(np.array(drawn).T)
    # The heading of a tilted vehicle is not quite the turn about the vertical.
    level = [0, 1, 2, 3, 5]
    assert claimed is not None
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(
        (claimed / scale)[np.ix_(level, level)], (found / scale)[np.ix_(level, level)], atol=0.08
    )


@pytest.mark.parametrize("first", [0.0, -1.0, 1e6, math.inf])
def test_a_covariance_that_nobody_knows_is_none(first: float) -> None:
    """All zeros, -1 in the first entry, or a million for each quantity; of both pose and twist."""
    matrix = np.diag([first] * 6) if first > 0.0 else np.diag([first, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert estimate(pose_covariance=matrix, twist_covariance=matrix).covariance is None


@pytest.mark.parametrize(("unknown", "angle"), [(1e6, 1e6), (99e9, 99_999.0), (math.inf, 1e3), (-1.0, -1.0)])
def test_a_quantity_that_is_not_given_adds_nothing_to_the_others(unknown: float, angle: float) -> None:
    """With z, roll and pitch at 1e6 the velocity had a standard deviation of 19.6 m/s for one of 0.1 m/s."""
    pose = np.diag([0.04, 0.09, unknown, angle, angle, 0.01])
    pose[5, 4] = pose[4, 5] = 50.0  # of a quantity that is not given
    twist = np.diag([0.01, 0.01, unknown, unknown, unknown, 0.0004])
    tilted = Rotation.from_euler("xyz", (0.1, -0.2, 0.3)).as_quat()
    moving: dict[str, Any] = {"quaternion": tuple(tilted), "linear": (2.0, 0.3, 0.1), "angular": (0.1, 0.2, 0.3)}
    found = estimate(pose_covariance=pose, twist_covariance=twist, **moving).covariance
    pose, twist = np.diag([0.04, 0.09, 0, 0, 0, 0.01]), np.diag([0.01, 0.01, 0, 0, 0, 0.0004])
    plain = estimate(pose_covariance=pose, twist_covariance=twist, **moving).covariance
    np.testing.assert_allclose(found, plain, atol=1e-12)


def test_what_is_given_is_used_beside_what_is_not() -> None:
    twist = np.diag([0.01, 0.04, 0.0, 0.0, 0.0, 0.0004])
    found = estimate(linear=(2.0, 0.0, 0.0), twist_covariance=twist).covariance  # it goes east
    np.testing.assert_allclose(found, np.diag([25.0, 25.0, 0.04, 0.01, 0.25, 0.0004]), atol=1e-12)
    pose = np.diag([1e6, 0.09, 0.0, 0.0, 0.0, 0.01])
    pose[0, 5] = pose[5, 0] = 50.0
    found = estimate(pose_covariance=pose, twist_covariance=np.diag([-1.0, 0, 0, 0, 0, 0])).covariance
    np.testing.assert_allclose(found, np.diag([0.09, 25.0, 0.0, 0.0, 0.01, 0.0]), atol=1e-12)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"quaternion": (0.0, 0.0, 0.0, 0.5)}, "length 0.5"),
        ({"quaternion": (math.nan, 0.0, 0.0, 1.0)}, "length nan"),
        ({"frame": "odom_ned"}, "frame odom_ned"),
        ({"child": "base_link_frd"}, "frame base_link_frd"),
        ({"angular": (1e300, 0.0, 0.0)}, "angular: a value is not a number"),
        ({"pose_covariance": np.full((6, 6), math.nan)}, "pose.covariance: a value is not a number"),
    ],
)
def test_what_is_no_attitude_another_frame_or_no_number_is_refused(fields: dict[str, Any], reason: str) -> None:
    with pytest.raises(Refused, match=reason):
        estimate(**fields)


# --- the process -----------------------------------------------------------------------------------------------------


def test_a_flood_on_one_topic_takes_no_room_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.processes.ros2.monotonic_us", lambda: 7_000_000)
    receivers: dict[str, ForeignReceiver] = {}
    session: Any = SimpleNamespace(identifier="1", receive=receivers.__setitem__)
    mailbox = Mailbox()
    RosLink(session, Bridge(), tuple(row for row in TABLE if row.direction is IN), mailbox)
    for _ in range(FROM_PUBLISHER):
        receivers["obstacles"](b"x", b"")
    receivers["odometry"](b"x", b"")
    burst = FROM_PUBLISHER // 2 + 1  # half a second, and the first
    assert (len(mailbox), mailbox.overflowed) == (burst + 1, FROM_PUBLISHER - burst)


def test_the_process_translates_between_the_two_key_spaces(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    spaces = ("--namespace", "auv/7", "--ros-namespace", "bridge")
    estimates, forces, sequence = Mailbox(), Mailbox(), itertools.count()
    with (
        open_session(BusOptions(listen=(endpoint,)), stop=StopRequest(), say=print) as session,
        started(*CLI, "ros2", "--connect", endpoint, *spaces) as (edge, _),
    ):
        session.subscribe("auv/7/estimate", BY_TYPE[Estimate], estimates)
        session.subscribe("bridge/thrusters/starboard/thrust", None, forces)
        put_odometry, put_plan = (session.publisher(key).put for key in ("bridge/odometry", "auv/7/plan"))

        def odometry_there() -> bool:
            put_odometry(odometry(position=(3.0, 4.0, -5.0), stamp=divmod(time.monotonic_ns(), SECOND_NS)))
            return len(estimates) > 0

        def force() -> float | None:
            header = Header(epoch=1, sequence=next(sequence), sent_monotonic_us=0)
            put_plan(encode(plan(time.monotonic_ns() - SECOND_NS), header))
            return newest()

        def newest() -> float | None:
            if (frame := forces.take(0.3)) is None:
                return None
            assert frame.payload[:4] == b"\0\1\0\0"
            return float(struct.unpack("<d", frame.payload[4:])[0])

        until(odometry_there)
        heard = estimates.take(0.0)
        assert heard is not None
        read = decode(Estimate, heard.payload)[0]
        assert (read.north_m, read.east_m, read.depth_m) == (4.0, 3.0, 5.0)
        until(lambda: force() == pytest.approx(-20.0))
        edge.terminate()
        assert edge.wait(30) == 0
        assert list(iter(newest, None))[-1] == 0.0  # its last word
