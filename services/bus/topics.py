"""Table of topics: message type, key, period, writer and readers.

Keys, documentation and the channels of a recording all come from this table.
"""

from __future__ import annotations

import re
from functools import lru_cache

import msgspec

from ltv_mpc import messages
from ltv_mpc.messages import ControllerState, Estimate, EstimatorState, Message
from ltv_mpc.node import DEFAULT_SOURCE

OPERATOR = "operator"
"""Writer of commands: `ltv-mpc ctl`, a pilot's program and, in a simulation, the plant, which arms."""


class Topic(msgspec.Struct, frozen=True):
    """Row of the table of topics.

    ``written_by`` is the only writer. "*" stands for every node, which then appends its name to the key. ``OPERATOR``
    stands for any source of commands: several may publish on one key, each under an epoch of its own. Of a type in
    ``NAMED`` other sources may publish beside the writer, on keys of their own.
    ``read_by`` are the processes that subscribe; "*" stands for every process. A type whose only reader is the process
    that publishes it, such as ``CycleTiming``, reaches its node without the bus.
    ``period_ns`` is the vehicle time between two messages, 0 if they are published on events.
    """

    message_type: type[Message]
    key: str
    period_ns: int
    written_by: str
    read_by: tuple[str, ...]


TOPICS = (
    #     message type                 key                    period_ns       written by    read by
    Topic(messages.Truth,              "world/truth",             10_000_000, "plant",      ("sensors",)),
    Topic(messages.Disturbance,        "world/disturbance",                0, OPERATOR,     ("plant",)),
    Topic(messages.Applied,            "applied",                100_000_000, "plant",      ("controller",)),
    Topic(messages.ImuSamples,         "sensor/imu",              50_000_000, "sensors",    ("estimator",)),
    Topic(messages.GnssFix,            "sensor/gnss",          1_000_000_000, "sensors",    ("estimator",)),
    Topic(messages.TdcpFix,            "sensor/tdcp",          1_000_000_000, "sensors",    ("estimator",)),
    Topic(messages.AdcpPing,           "sensor/adcp",            333_333_333, "sensors",    ("estimator",)),
    Topic(messages.PressureDepth,      "sensor/depth",           100_000_000, "sensors",    ("estimator",)),
    Topic(messages.CompassHeading,     "sensor/compass",       1_000_000_000, "sensors",    ("estimator",)),
    Topic(messages.BottomTrack,        "sensor/bottom_track",    333_333_333, "sensors",    ("estimator",)),
    Topic(messages.LblRange,           "sensor/lbl",          10_000_000_000, "sensors",    ("estimator",)),
    Topic(messages.UsblFix,            "sensor/usbl",          2_000_000_000, "sensors",    ("estimator",)),
    Topic(messages.LocalisationReport, "localisation",         1_000_000_000, "estimator",  ()),
    Topic(messages.Estimate,           "estimate",               100_000_000, "estimator",  ("controller",)),
    Topic(messages.Plan,               "plan",                   300_000_000, "controller", ("plant",)),
    Topic(messages.Command,            "command",                          0, OPERATOR,     ("controller",)),
    Topic(messages.Manual,             "manual",                 100_000_000, OPERATOR,     ("controller",)),
    Topic(messages.Heartbeat,          "heartbeat",            1_000_000_000, OPERATOR,     ("controller",)),
    Topic(messages.Battery,            "battery",              1_000_000_000, "battery",    ("controller",)),
    Topic(messages.Leak,               "leak",                 1_000_000_000, "leak",       ("controller",)),
    Topic(messages.Obstacles,          "obstacles",                        0, OPERATOR,     ("controller",)),
    Topic(messages.Acknowledgement,    "acknowledged",                     0, "controller", (OPERATOR,)),
    Topic(messages.ControllerStatus,   "controller/status",    1_000_000_000, "controller", (OPERATOR,)),
    Topic(messages.FenceInForce,       "fence",               10_000_000_000, "controller", (OPERATOR,)),
    Topic(messages.ModelCheck,         "model",                1_000_000_000, "controller", (OPERATOR,)),
    Topic(messages.CycleTiming,        "timing",                 300_000_000, "controller", ("controller",)),
    Topic(messages.ClockStep,          "clock/step",                       0, "controller", ("controller",)),
    Topic(messages.ControllerState,    "state/controller",     5_000_000_000, "controller", ("supervisor",)),
    Topic(messages.EstimatorState,     "state/estimator",      5_000_000_000, "estimator",  ("supervisor",)),
    Topic(messages.Clock,              "clock",                            0, "plant",      ("*",)),
    Topic(messages.ClockCommand,       "clock/command",                    0, OPERATOR,     ("plant",)),
    Topic(messages.Kill,               "world/kill",                       0, OPERATOR,     ("supervisor",)),
    Topic(messages.NodeStatus,         "status",                           0, "*",          ("supervisor", "plant")),
    Topic(messages.NodeSettings,       "settings",        10_000_000_000, "*",          ()),
    Topic(messages.StepRecord,         "record",                           0, "*",          ()),
    Topic(messages.RejectedFrame,      "rejected",                         0, "*",          ()),
    Topic(messages.RunEvent,           "event",                            0, "*",          ("supervisor",)),
)  # fmt: skip

BY_TYPE = {topic.message_type: topic for topic in TOPICS}
STATES: dict[str, type[ControllerState] | type[EstimatorState]] = {
    "controller": ControllerState,
    "estimator": EstimatorState,
}
"""State that a process publishes, by its name; a restarted process continues from the newest one."""

BY_KEY = {topic.key: topic for topic in TOPICS}

NAMED: frozenset[type[Message]] = frozenset({Estimate})
"""Types that several sources may publish, each on a key of its own: the key of the table, a slash, and its name."""

_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")


def key_of(kind: type[Message], writer: str) -> str:
    """Return the key on which ``writer`` publishes; on a key of every node its name is appended."""
    topic = BY_TYPE[kind]
    return f"{topic.key}/{writer}" if topic.written_by == "*" else topic.key


def expression(topic: Topic) -> str:
    """Return the key expression of all keys of a topic."""
    if topic.message_type in NAMED:
        return f"{topic.key}/**"  # the key of the table too
    return f"{topic.key}/*" if topic.written_by == "*" else topic.key


@lru_cache(4096)
def topic_at(key: str) -> Topic | None:
    """Return the row of a key as published, or None for an unknown key."""
    topic = BY_KEY.get(key)
    if topic is not None:
        return topic if topic.written_by != "*" else None
    table_key, _, name = key.rpartition("/")
    topic = BY_KEY.get(table_key)
    if topic is None or topic.written_by == "*":
        return topic
    return topic if topic.message_type in NAMED and is_source_name(name) else None


def is_source_name(name: str) -> bool:
    """Return True if a source may have this name, on a key of its own."""
    return name != DEFAULT_SOURCE and _NAME.fullmatch(name) is not None


def table_key(key: str) -> str:
    """Return the key in the table of the source on ``key``; any other key as it is."""
    topic = topic_at(key)
    return topic.key if topic is not None and topic.message_type in NAMED else key


def source_of(key: str) -> str:
    """Return the name of the source that publishes on a key."""
    return DEFAULT_SOURCE if key in BY_KEY else key.rpartition("/")[2]
