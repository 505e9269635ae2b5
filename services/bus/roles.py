"""Roles of a secured bus: the keys that each process may write and read, derived from the table of topics.

A role is the common name of a certificate. The writer of a row may publish on its key and the readers may subscribe.
The router denies everything else; a certificate without a role may do nothing. A source of estimates with a name has a
role of its own, ``estimator-<name>``, which may publish on ``estimate/<name>``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ltv_mpc.messages import Estimate, NodeStatus, Truth
from services.bus.topics import BY_TYPE, OPERATOR, TOPICS, Topic, expression

ANYONE = "*"

ROUTER, LAUNCHER, RECORDER, DISPLAY = "router", "launcher", "recorder", "display"

SEES_EVERYTHING = (LAUNCHER, RECORDER, DISPLAY, OPERATOR)
"""Roles that may read every topic, because they record or show all of them."""

SIMULATED = BY_TYPE[Truth].written_by
"""Role of the simulated vehicle: it is the clock master, so it reads the others' status, and it arms its controller."""


SOURCE_PREFIX = f"{BY_TYPE[Estimate].written_by}-"
"""Start of the role of a named source."""


def _named(topics: Iterable[Topic]) -> tuple[str, ...]:
    named = (name for topic in topics for name in (topic.written_by, *topic.read_by) if name != ANYONE)
    return tuple(dict.fromkeys(named))


ROLES = tuple(dict.fromkeys((ROUTER, *_named(TOPICS), *SEES_EVERYTHING)))
"""All roles, the router's first."""


def writes(role: str) -> tuple[str, ...]:
    """Return the keys on which ``role`` may publish; of a key of every node, only the role's own."""
    acts_as = (role, OPERATOR) if role == SIMULATED else (role,)
    if role.startswith(SOURCE_PREFIX):
        return (f"{BY_TYPE[Estimate].key}/{role.removeprefix(SOURCE_PREFIX)}",)
    return tuple(
        f"{topic.key}/{role}" if topic.written_by == ANYONE else topic.key
        for topic in TOPICS
        if topic.written_by in (ANYONE, *acts_as)
    )


def reads(role: str) -> tuple[str, ...]:
    """Return the key expressions to which ``role`` may subscribe."""
    if role in SEES_EVERYTHING:
        return ("**",)
    return tuple(expression(topic) for topic in TOPICS if _reads(role, topic))


def _reads(role: str, topic: Topic) -> bool:
    return role in topic.read_by or ANYONE in topic.read_by or (role == SIMULATED and topic.message_type is NodeStatus)


def access_control(namespace: str, sources: Iterable[str] = ()) -> dict[str, Any]:
    """Return Zenoh's ``access_control`` for a router: default deny, one subject a role, by the common name.

    With a ``namespace`` the rights hold in that one only; without, in every namespace. ``sources`` are the roles of the
    named sources. The router is no subject: its own messages use no link.
    """
    subjects = [role for role in (*ROLES, *sources) if role != ROUTER]
    rules = [rule for role in subjects for rule in _rules(role, namespace)]
    policies = [{"subjects": [role], "rules": [rule["id"] for rule in _rules(role, namespace)]} for role in subjects]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": role, "cert_common_names": [role]} for role in subjects],
        "policies": policies,
    }


def _rules(role: str, namespace: str) -> list[dict[str, Any]]:
    """Return the rules of one role: ingress for its publications and subscriptions, egress for what it reads.

    Every role learns of all subscribers. Zenoh's publishers send nothing if they know of no subscriber, so without this
    rule an attempt of a wrong role to publish would never reach the router and would not be counted.
    """

    def rule(name: str, messages: list[str], flow: str, keys: Iterable[str]) -> dict[str, Any]:
        return {
            "id": f"{role} {name}",
            "permission": "allow",
            "messages": messages,
            "flows": [flow],
            "key_exprs": [_within(namespace, key) for key in keys],
        }

    rules = [rule("learns of subscribers", ["declare_subscriber"], "egress", ["**"])]
    if writable := writes(role):
        rules.append(rule("puts", ["put"], "ingress", writable))
    if readable := reads(role):
        rules.append(rule("subscribes", ["declare_subscriber"], "ingress", readable))
        rules.append(rule("is given", ["put"], "egress", readable))
    return rules


def _within(namespace: str, key: str) -> str:
    prefix = namespace or "**"
    return key if prefix == key else f"{prefix}/{key}"
