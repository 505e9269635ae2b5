"""Roles of a secured bus: the keys that each process may write and read, derived from the table of topics.

A role is the common name of a certificate. The writer of a row may publish on its key and the readers may subscribe.
The router denies everything else; a certificate without a role may do nothing. A source of estimates with a name has a
role of its own, ``estimator-<name>``, which may publish on ``estimate/<name>``. An edge may do part of what estimator
and operator may. ``ros-<domain>`` is the role of all nodes of a ROS 2 domain, and of the edge on their side.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from ltv_mpc.messages import (
    Acknowledgement,
    Applied,
    Command,
    ControllerStatus,
    Estimate,
    FenceInForce,
    Obstacles,
    Plan,
    Truth,
)
from services.bus.topics import BY_TYPE, OPERATOR, TOPICS, Topic, expression

ANYONE = "*"

ROUTER, SUPERVISOR, RECORDER, DISPLAY = "router", "supervisor", "recorder", "display"

SEES_EVERYTHING = (SUPERVISOR, RECORDER, DISPLAY, OPERATOR)
"""Roles that may read every topic, because they record or show all of them."""

HISTORY = "history"
"""Key on which the recorder answers queries of those that may read everything."""

SIMULATED = BY_TYPE[Truth].written_by
"""Role of the simulated vehicle: it arms its controller."""


SOURCE_PREFIX = f"{BY_TYPE[Estimate].written_by}-"
"""Start of the role of a named source."""


EDGES = ("ros2", "mavlink")
"""Roles of the edges, which replace the estimator and command as operators do."""

EDGE_WRITES = (Estimate, Command, Obstacles, Applied)
EDGE_READS = (Plan, Acknowledgement, Command, ControllerStatus, Estimate, FenceInForce)

ROS_PREFIX = "ros-"
"""Start of the role of the nodes of a ROS 2 domain."""


def _named(topics: Iterable[Topic]) -> tuple[str, ...]:
    named = (name for topic in topics for name in (topic.written_by, *topic.read_by) if name != ANYONE)
    return tuple(dict.fromkeys(named))


ROLES = tuple(dict.fromkeys((ROUTER, *_named(TOPICS), *SEES_EVERYTHING, *EDGES)))
"""All roles, the router's first."""


def writes(role: str) -> tuple[str, ...]:
    """Return the keys on which ``role`` may publish; of a key of every node, only the role's own."""
    acts_as = (role, OPERATOR) if role == SIMULATED else (role,)
    if role.startswith(SOURCE_PREFIX):
        return (f"{BY_TYPE[Estimate].key}/{role.removeprefix(SOURCE_PREFIX)}",)
    own = EDGE_WRITES if role in EDGES else ()
    return tuple(
        f"{topic.key}/{role}" if topic.written_by == ANYONE else topic.key
        for topic in TOPICS
        if topic.written_by in (ANYONE, *acts_as) or topic.message_type in own
    )


def reads(role: str) -> tuple[str, ...]:
    """Return the key expressions to which ``role`` may subscribe."""
    if role in SEES_EVERYTHING:
        return ("**",)
    return tuple(expression(topic) for topic in TOPICS if _reads(role, topic))


def _reads(role: str, topic: Topic) -> bool:
    if role in EDGES:
        return topic.message_type in EDGE_READS
    return role in topic.read_by or ANYONE in topic.read_by


def access_control(namespace: str, others: Iterable[str] = ()) -> dict[str, Any]:
    """Return Zenoh's ``access_control`` for a router: default deny, one subject a role, by the common name.

    With a ``namespace`` the rights hold in that one only; without, in every namespace. ``others`` are the roles of
    named sources and of ROS 2 domains. The router is no subject: its own messages use no link.
    """
    subjects = [role for role in (*ROLES, *others) if role != ROUTER]
    rules = {role: _rules(role, namespace) for role in subjects}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for of_role in rules.values() for rule in of_role],
        "subjects": [{"id": role, "cert_common_names": [role]} for role in subjects],
        "policies": [
            {"subjects": [role], "rules": [rule["id"] for rule in of_role]} for role, of_role in rules.items()
        ],
    }


def _rules(role: str, namespace: str) -> list[dict[str, Any]]:
    """Return the rules of one role: ingress for its publications and subscriptions, egress for what it reads.

    Every role learns of all subscribers. Zenoh's publishers send nothing if they know of no subscriber, so without this
    rule an attempt of a wrong role to publish would never reach the router and would not be counted.

    A node of a ROS 2 domain may do everything on its keys, which are in no namespace, and nothing elsewhere. A ``**``
    does not match a part that begins with ``@``, which latched topics have.
    """
    if role.startswith(ROS_PREFIX):
        domain = role.removeprefix(ROS_PREFIX)
        keys = f"{domain}/**", f"{domain}/**/@adv/**", f"@ros2_lv/{domain}/**"
        return [_rule(role, "is a node", ROS_MESSAGES, ("ingress", "egress"), keys)]

    def rule(name: str, messages: Sequence[str], flow: str, keys: Iterable[str]) -> dict[str, Any]:
        return _rule(role, name, messages, (flow,), [_within(namespace, key) for key in keys])

    rules = [rule("learns of subscribers", ["declare_subscriber"], "egress", ["**"])]
    if writable := writes(role):
        rules.append(rule("puts", ["put"], "ingress", writable))
    if readable := reads(role):
        rules.append(rule("subscribes", ["declare_subscriber"], "ingress", readable))
        rules.append(rule("is given", ["put"], "egress", readable))
    if role == RECORDER:
        rules.append(rule("offers the history", ["declare_queryable", "reply"], "ingress", [HISTORY]))
        rules.append(rule("is asked for the history", ["query"], "egress", [HISTORY]))
    elif role in SEES_EVERYTHING:
        rules.append(rule("asks for the history", ["query"], "ingress", [HISTORY]))
        rules.append(rule("is given the history", ["declare_queryable", "reply"], "egress", [HISTORY]))
    return rules


def _rule(role: str, name: str, messages: Sequence[str], flows: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    return {
        "id": f"{role} {name}",
        "permission": "allow",
        "messages": messages,
        "flows": flows,
        "key_exprs": keys,
    }


def _within(namespace: str, key: str) -> str:
    prefix = namespace or "**"
    return key if prefix == key else f"{prefix}/{key}"


ROS_MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
"""All kinds of messages: nodes find each other by liveliness tokens; services and latched topics are queries."""
