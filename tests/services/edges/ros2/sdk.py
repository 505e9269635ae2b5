"""ROS 2 node by zenoh-ros2-sdk: an implementation of rmw_zenoh that nobody here wrote. Run as a process of its own.

Its definitions of messages come from files that ``prepare`` writes, in the syntax of ROS: it would download them.
"""

from __future__ import annotations

import json
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

DEFINITIONS = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/msg/Float64": "float64 data",
    "std_msgs/msg/String": "string data",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/msg/Pose": "Point position\nQuaternion orientation",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\nPose pose",
    "geometry_msgs/msg/PoseWithCovariance": "Pose pose\nfloat64[36] covariance",
    "geometry_msgs/msg/Twist": "Vector3 linear\nVector3 angular",
    "geometry_msgs/msg/TwistWithCovariance": "Twist twist\nfloat64[36] covariance",
    "geometry_msgs/msg/Transform": "Vector3 translation\nQuaternion rotation",
    "geometry_msgs/msg/TransformStamped": "std_msgs/Header header\nstring child_frame_id\nTransform transform",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "nav_msgs/msg/Odometry": "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
    "geometry_msgs/TwistWithCovariance twist",
    "nav_msgs/msg/Path": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
    "diagnostic_msgs/msg/KeyValue": "string key\nstring value",
    "diagnostic_msgs/msg/DiagnosticStatus": "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\n"
    "string name\nstring message\nstring hardware_id\nKeyValue[] values",
    "diagnostic_msgs/msg/DiagnosticArray": "std_msgs/Header header\nDiagnosticStatus[] status",
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message",
    "std_srvs/srv/Trigger": "---\nbool success\nstring message",
}
TRIGGER_HASH = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
"""Of std_srvs/srv/Trigger in ROS 2; the SDK cannot hash an empty request."""


def prepare(folder: Path) -> None:
    """Write the definitions and let the SDK read them."""
    from zenoh_ros2_sdk import message_registry

    for name, text in DEFINITIONS.items():
        path = folder / f"{name}.{name.split('/')[1]}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    message_registry.get_registry(str(folder))


class Node:
    """Publishers, subscriptions and clients of one node."""

    def __init__(self, port: int, domain: int) -> None:
        from zenoh_ros2_sdk import ZenohSession

        self.where: dict[str, Any] = {"domain_id": domain, "router_ip": "127.0.0.1", "router_port": port}
        ZenohSession.get_instance("127.0.0.1", port)  # the registry asks for one without a port

    def make(self, name: str, **fields: Any) -> Any:
        from zenoh_ros2_sdk import get_message_class

        kind = get_message_class(name)
        assert kind is not None
        return kind(**fields)

    def publisher(self, topic: str, kind: str) -> Any:
        from zenoh_ros2_sdk import ROS2Publisher

        return ROS2Publisher(topic=topic, msg_type=kind, node_name="craft", **self.where)

    def subscribe(self, topic: str, kind: str, callback: Any, qos: str | None = None) -> Any:
        from zenoh_ros2_sdk import ROS2Subscriber

        return ROS2Subscriber(topic=topic, msg_type=kind, callback=callback, qos=qos, node_name="craft", **self.where)

    def call(self, service: str, kind: str, **fields: Any) -> Any:
        from zenoh_ros2_sdk import ROS2ServiceClient

        given: dict[str, Any] = {"type_hash": TRIGGER_HASH} if kind.endswith("Trigger") else {}
        if given:
            given |= {"request_definition": "uint8 structure_needs_at_least_one_member"}
            given |= {"response_definition": "bool success\nstring message"}
        client = ROS2ServiceClient(service, kind, timeout=5.0, node_name="craft", **given, **self.where)
        response = client.call(**fields)
        client.close()
        return response

    def odometry(self) -> dict[str, Any]:
        """Return the fields of an odometry message of now, at rest: ENU, FLU."""
        import numpy as np

        def of(kind: str, **fields: Any) -> Any:
            return self.make(f"geometry_msgs/msg/{kind}", **fields)

        sec, nanosec = divmod(time.time_ns(), 1_000_000_000)
        stamp = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        turn, zeros = of("Quaternion", x=0.0, y=0.0, z=0.0, w=1.0), np.zeros(36)
        rest = of("Vector3", x=0.0, y=0.0, z=0.0)
        pose = of("Pose", position=of("Point", x=1.0, y=2.0, z=-3.0), orientation=turn)
        return {
            "header": self.make("std_msgs/msg/Header", stamp=stamp, frame_id="odom"),
            "child_frame_id": "base_link",
            "pose": of("PoseWithCovariance", pose=pose, covariance=zeros),
            "twist": of("TwistWithCovariance", twist=of("Twist", linear=rest, angular=rest), covariance=zeros),
        }


def say(**fields: Any) -> None:
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def main(port: int, domain: int, fence: str) -> None:
    """List the topics, publish odometry and a fence, echo what the edge publishes, and call its services."""
    from zenoh_ros2_sdk import get_service_names_and_types, get_topic_info, get_topic_names_and_types

    with tempfile.TemporaryDirectory() as folder:
        prepare(Path(folder))
        node = Node(port, domain)
        where = dict(node.where)
        while "/odometry" not in (topics := dict(get_topic_names_and_types(**where))):
            time.sleep(0.1)
        info = get_topic_info("/odometry", verbose=True, **where)
        assert info is not None
        (end,) = info.subscribers
        say(topics=topics, services=dict(get_service_names_and_types(**where)))
        say(node=end.node_name, type_hash=end.type_hash, subscribers=info.subscriber_count)
        stopped = threading.Event()
        out = node.publisher("/odometry", "nav_msgs/msg/Odometry")
        say(own_hash=out.type_hash, key=out.keyexpr)

        def publish() -> None:
            while not stopped.wait(0.1):
                out.publish(**node.odometry())

        threading.Thread(target=publish, daemon=True).start()
        pushed = threading.Event()
        fences = node.publisher("/fence", "std_msgs/msg/String")

        def on_thrust(message: Any) -> None:
            say(thrust=message.data)
            if message.data != 0.0:
                pushed.set()

        node.subscribe("/thrusters/port/thrust", "std_msgs/msg/Float64", on_thrust)
        node.subscribe("/plan", "nav_msgs/msg/Path", lambda m: say(path=len(m.poses)))
        node.subscribe(
            "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", lambda m: say(diagnostics=m.status[0].name)
        )
        node.subscribe(
            "/tf_static", "tf2_msgs/msg/TFMessage", lambda m: say(tf=m.transforms[0].child_frame_id), ":1:,1:,:,:,,"
        )
        for service, kind, fields in (
            ("/ltv_mpc/arm", "SetBool", {"data": True}),
            ("/ltv_mpc/hold", "SetBool", {"data": False}),
            ("/ltv_mpc/stop", "Trigger", {"structure_needs_at_least_one_member": 0}),
        ):
            if service == "/ltv_mpc/stop":
                pushed.wait()
            response = None
            while response is None or "no estimate" in response.message or "no reply" in response.message:
                response = node.call(service, f"std_srvs/srv/{kind}", **fields)
            say(service=service, success=bool(response.success), message=response.message)
        while not stopped.wait(0.5):
            fences.publish(data=fence)  # the first message on a key can be lost


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
