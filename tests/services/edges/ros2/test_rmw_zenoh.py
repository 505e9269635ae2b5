"""ROS 2 over rmw_zenoh: names and hashes beside those of others, and the edge beside a node by zenoh-ros2-sdk."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import zenoh

from ltv_mpc.messages import Estimate, FenceInForce
from services.bus import certificates
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.roles import ROLES, access_control
from services.bus.session import configuration, open_session
from services.bus.topics import BY_TYPE, expression
from services.bus.wire import decode
from services.edges.edge import Refused
from services.edges.ros2.cdr import type_hash
from services.edges.ros2.middleware import Attachment, RmwZenoh, dds_type, gid_of
from services.edges.ros2.topics import BY_NAME, IN, OUT, SERVICE, TABLE
from services.runtime.stopping import StopRequest
from tests.fuzz.targets import SQUARE_FENCE
from tests.services.edges.ros2.sdk import DEFINITIONS
from tests.services.edges.ros2.test_ros2 import odometry
from tests.system.alone import CLI, controller, started

NOT_INSTALLED = "not installed: pip install zenoh-ros2-sdk pamoja-ros2 (extra dev)"


def test_a_hash_is_that_of_ros_itself() -> None:
    """As a ROS 2 node with rmw_zenoh has logged it."""
    assert type_hash("std_msgs/msg/String").endswith("df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")


def test_hashes_keys_and_tokens_are_those_of_other_implementations() -> None:
    utils = pytest.importorskip("zenoh_ros2_sdk.utils", reason=NOT_INSTALLED)
    from zenoh_ros2_sdk.discovery import _parse_liveliness_keyexpr
    from zenoh_ros2_sdk.qos import QosDurability, QosProfile

    pamoja = pytest.importorskip("pamoja.ros2", reason=NOT_INSTALLED)
    middleware = RmwZenoh(7)
    tokens = middleware.tokens(TABLE, "a1b2")
    assert tokens[0] == "@ros2_lv/7/a1b2/0/0/NN/%/%/ltv_mpc"
    compared = 0
    for row, token in zip(TABLE, tokens[1:], strict=True):
        read = _parse_liveliness_keyexpr(token)
        assert (read["qualified_name"], read["kind"]) == (row.topic, row.direction.value)
        assert (read["dds_type"], read["type_hash"]) == (dds_type(row.ros_type), type_hash(row.ros_type))
        latched = QosProfile.decode(read["qos"]).durability is QosDurability.TRANSIENT_LOCAL
        assert latched == row.latched
        # pamoja-ros2 does not know that a service has its own type
        if row.direction is not SERVICE:
            key = pamoja.entity_key(7, row.topic, row.ros_type, type_hash(row.ros_type))
            assert middleware.key(row) == key
        if row.ros_type in DEFINITIONS and "/msg/" in row.ros_type:
            text = DEFINITIONS[row.ros_type]
            others = {name: of for name, of in DEFINITIONS.items() if name != row.ros_type and "/msg/" in name}
            assert utils.compute_type_hash_from_msg(row.ros_type, text, others) == type_hash(row.ros_type)
            compared += 1
    assert compared >= 7


def test_an_attachment_is_that_of_another_implementation() -> None:
    attachment = pytest.importorskip("zenoh_ros2_sdk.attachment", reason=NOT_INSTALLED).Attachment
    gid = gid_of("token")
    packed = Attachment(5, 1_700_000_000_000_000_001, gid).pack()
    assert len(packed) == 33
    assert packed == attachment(5, 1_700_000_000_000_000_001, gid).to_bytes()
    assert Attachment.unpack(packed).gid == gid
    for broken in (b"", packed[:-1], packed[:16] + b"\x11" + packed[17:]):
        with pytest.raises(Refused):
            Attachment.unpack(broken)


@pytest.mark.timeout(300)
def test_a_node_by_another_sdk_lists_echoes_publishes_and_calls(free_port: int, tmp_path: Path) -> None:
    pytest.importorskip("zenoh_ros2_sdk", reason=NOT_INSTALLED)
    said: list[dict[str, Any]] = []

    def until_stopped(line: str) -> bool:
        if line.startswith("{"):
            said.append(json.loads(line))
        return said[-1:] != [] and said[-1].get("service") == "/ltv_mpc/stop"

    (tmp_path / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    arguments = ("--vehicle", "paper", "--reference", str(tmp_path / "point.toml"))
    with (
        controller(free_port, arguments) as (endpoint, _),
        started(*CLI, "ros2", "--middleware", "rmw_zenoh", "--domain-id", "5", "--connect", endpoint) as (_, edge),
    ):
        edge.until(lambda line: "writes" in line)  # every topic and service is declared
        sdk = (sys.executable, "-P", "-m", "tests.services.edges.ros2.sdk", str(free_port), "5", SQUARE_FENCE)
        fences = Mailbox()
        with (
            open_session(BusOptions(connect=(endpoint,)), stop=StopRequest(), say=print) as bus,
            started(*sdk) as (_, node),
        ):
            bus.subscribe(expression(BY_TYPE[FenceInForce]), BY_TYPE[FenceInForce], fences)
            node.until(until_stopped, within_s=200.0)
            frame = fences.take(60.0)
            assert frame is not None, "no fence in force"
            assert [zone.keep_in for zone in decode(FenceInForce, frame.payload)[0].zones] == [True]
    found = {name: value for line in said for name, value in line.items()}
    used = [row for row in TABLE if row.name != "thrusts"]
    assert found["topics"] == {row.topic: [row.ros_type] for row in used if row.direction in (IN, OUT)}
    assert found["services"] == {row.topic: [row.ros_type] for row in used if row.direction is SERVICE}
    assert found["node"] == "ltv_mpc"
    assert found["type_hash"] == found["own_hash"] == type_hash("nav_msgs/msg/Odometry")
    assert found["tf"] == "base_link_origin"
    assert found["path"] > 10
    assert found["diagnostics"] == "ltv_mpc: controller"
    answers = {line["service"]: (line["success"], line["message"]) for line in said if "service" in line}
    assert answers["/ltv_mpc/arm"] == (True, "controller")
    assert answers["/ltv_mpc/hold"][0] is False
    assert answers["/ltv_mpc/stop"] == (True, "stopped")
    assert any(line.get("thrust") for line in said)


def test_a_node_of_a_domain_may_do_everything_there_and_nothing_elsewhere() -> None:
    control = access_control("auv/7", ["ros-5"])
    (rule,) = (rule for rule in control["rules"] if rule["id"].startswith("ros-5"))
    assert list(rule["key_exprs"]) == ["5/**", "5/**/@adv/**", "@ros2_lv/5/**"]
    assert {"declare_queryable", "query", "liveliness_token", "declare_liveliness_subscriber"} <= set(rule["messages"])


@pytest.mark.timeout(120)
def test_the_edge_works_on_a_secured_bus(free_port: int, tmp_path: Path) -> None:
    """A node with the certificate of the domain sees the edge's tokens and its latched topic, and is estimated."""
    certificates.make(tmp_path, [*ROLES, "ros-5"], hosts=(), days=1)
    endpoint = f"tls/127.0.0.1:{free_port}"
    bus = ("--certs", str(tmp_path))
    with started(*CLI, "router", "--listen", endpoint, *bus) as (_, router):
        router.until(lambda line: "ready at" in line)
        edge = (*CLI, "ros2", "--middleware", "rmw_zenoh", "--domain-id", "5", "--connect", endpoint, *bus)
        with started(*edge) as (_, said):
            said.until(lambda line: "writes" in line)
            options = BusOptions(connect=(endpoint,), certs=tmp_path, role="ros-5")
            with zenoh.open(configuration(options)) as node:
                check_secured(node, endpoint, tmp_path)


def check_secured(node: zenoh.Session, endpoint: str, folder: Path) -> None:
    """Check what a node of the domain, and a display, can see of the edge."""
    until = time.monotonic() + 60.0
    names: set[str] = set()
    while len(names) < len(TABLE):
        assert time.monotonic() < until, sorted(names)
        names = {str(reply.ok.key_expr) for reply in node.liveliness().get("@ros2_lv/5/**", timeout=2.0) if reply.ok}
    key = RmwZenoh(5).key(BY_NAME["tf_static"])
    latched = [reply for reply in node.get(f"{key}/@adv/pub/**?_anyke", timeout=5.0) if reply.ok]
    assert len(latched) == 1
    estimates = Mailbox()
    with open_session(
        BusOptions(connect=(endpoint,), certs=folder, role="display"), stop=StopRequest(), say=print
    ) as display:
        display.subscribe("estimate", BY_TYPE[Estimate], estimates)
        publisher = node.declare_publisher(RmwZenoh(5).key(BY_NAME["odometry"]))
        number = 0
        while estimates.take(0.1) is None:
            assert time.monotonic() < until, "no estimate"
            number += 1
            publisher.put(odometry(), attachment=Attachment(number, 0, bytes(16)).pack())
