"""Files for a user with ROS 2, checked as text: elements and commands of the launch file, topics and types of RViz."""

from __future__ import annotations

import re
import shlex
from typing import Any
from xml.etree import ElementTree

import pytest

pytest.importorskip("rosbags", reason="not installed: pip install rosbags (extra ros2)")

from services.edges.ros2.conversions import FRAME
from services.edges.ros2.topics import BY_NAME, IN, OUT, TABLE
from tests.docs.pages import ROOT
from tests.docs.test_blocks import parsed

FOLDER = ROOT / "examples" / "ros2"
PROCESS = {"name", "args", "output", "launch-prefix", "if", "unless", "respawn", "respawn_delay"}
ELEMENTS = {
    "launch": {"version"},
    "arg": {"name", "default", "description"},
    "executable": {"cmd", "cwd", "shell", *PROCESS},
    "node": {"pkg", "exec", "namespace", "ros_args", *PROCESS},
}
"""Elements and attributes of a launch file that are used here, of ROS 2's own schema."""

SHOWS = {
    "Odometry": "nav_msgs/msg/Odometry",
    "Path": "nav_msgs/msg/Path",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "Wrench": "geometry_msgs/msg/WrenchStamped",
    "SetGoal": "geometry_msgs/msg/PoseStamped",
    **dict.fromkeys(("Grid", "TF", "MoveCamera", "TopDownOrtho"), ""),
}
"""Type of the topic of each display and tool of rviz_default_plugins; empty: it has none."""

QUALITY = {
    "Depth": 5,
    "Durability Policy": "Volatile",
    "History Policy": "Keep Last",
    "Reliability Policy": "Reliable",
}


def test_the_launch_file_has_elements_of_ros_and_command_lines_of_ours() -> None:
    root = ElementTree.parse(FOLDER / "ltv_mpc.launch.xml").getroot()
    arguments = {of.attrib["name"]: of.attrib["default"] for of in root.findall("arg")}
    commands = []
    for element in root.iter():
        assert set(element.attrib) <= ELEMENTS[element.tag], element.attrib
        for text in element.attrib.values():
            for kind, name in re.findall(r"\$\((\w+) ?(\w*)", text):
                assert kind in ("env", "dirname") or (kind == "var" and name in arguments), text
        if element.tag == "executable":
            plain = re.sub(r"\$\(var (\w+)\)", lambda found: arguments[found[1]], element.attrib["cmd"])
            commands.append(shlex.split(re.sub(r"\$\(env \w+ (\w+)\)", r"\1", plain)))
    assert [words[:2] for words in commands] == [["ltv-mpc", name] for name in ("router", "controller", "ros2")]
    for _, *words in commands:
        parsed(words, "ltv_mpc.launch.xml")
    (node,) = root.findall("node")
    assert node.attrib["args"] == "-d $(dirname)/ltv_mpc.rviz"


def test_rviz_shows_every_topic_that_it_can_and_sends_goals() -> None:
    yaml = pytest.importorskip("yaml", reason="not installed: pip install pyyaml")
    manager = yaml.safe_load((FOLDER / "ltv_mpc.rviz").read_text())["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == FRAME
    shown: dict[str, tuple[str, Any]] = {}
    for one in (*manager["Displays"], *manager["Tools"], manager["Views"]["Current"]):
        package, _, kind = one["Class"].partition("/")
        assert package == "rviz_default_plugins"
        assert bool(SHOWS[kind]) is ("Topic" in one)
        if "Topic" in one:
            shown[one["Topic"].pop("Value")] = SHOWS[kind], one["Topic"]
    rows = [row for row in TABLE if row.ros_type in SHOWS.values() and (row.direction is OUT or row.name == "goal")]
    rows.append(BY_NAME["odometry"])
    assert {row.topic: (row.ros_type, QUALITY) for row in rows} == shown
    assert BY_NAME["goal"].direction is IN
