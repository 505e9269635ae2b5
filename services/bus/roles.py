"""Who may do what on a secured bus: one role a process, and its rights read off the topics table.

A role is the common name of a certificate. Whoever writes a row of the table may put on its key, whoever reads it may
subscribe, and everything else is denied by the router; a certificate of no role may do nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ltv_mpc.messages import NodeStatus, Truth
from services.bus.topics import BY_TYPE, OPERATOR, TOPICS, Topic

ANYONE = "*"

ROUTER, LAUNCHER, RECORDER, DISPLAY = "router", "launcher", "recorder", "display"

SEES_EVERYTHING = (LAUNCHER, RECORDER, DISPLAY, OPERATOR)
"""They may read every topic: what is recorded or shown is whatever there is."""

SIMULATED = BY_TYPE[Truth].written_by
"""The simulated vehicle: it keeps the time, so it reads the others' status, and it arms its controller itself."""


def _named(topics: Iterable[Topic]) -> tuple[str, ...]:
    named = (name for topic in topics for name in (topic.written_by, *topic.read_by) if name != ANYONE)
    return tuple(dict.fromkeys(named))


ROLES = tuple(dict.fromkeys((ROUTER, *_named(TOPICS), *SEES_EVERYTHING)))
"""Every role there is, the router's first."""


def writes(role: str) -> tuple[str, ...]:
    """The keys on which ``role`` may put; of a key that every node writes its own alone."""
    hats = (role, OPERATOR) if role == SIMULATED else (role,)
    return tuple(
        f"{topic.key}/{role}" if topic.written_by == ANYONE else topic.key
        for topic in TOPICS
        if topic.written_by in (ANYONE, *hats)
    )


def reads(role: str) -> tuple[str, ...]:
    """The key expressions to which ``role`` may subscribe."""
    if role in SEES_EVERYTHING:
        return ("**",)
    return tuple(_pattern(topic) for topic in TOPICS if _reads(role, topic))


def _reads(role: str, topic: Topic) -> bool:
    return role in topic.read_by or ANYONE in topic.read_by or (role == SIMULATED and topic.message_type is NodeStatus)


def _pattern(topic: Topic) -> str:
    return f"{topic.key}/*" if topic.written_by == ANYONE else topic.key


def access_control(namespace: str) -> dict[str, Any]:
    """Zenoh's ``access_control`` for a router: default deny, one subject a role, by the certificate's common name.

    With a ``namespace`` the rights hold in that one alone; without, in each. The router is no subject: what it says
    itself comes by no link.
    """
    subjects = [role for role in ROLES if role != ROUTER]
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
    """In: what it puts, what it subscribes to. Out: what it reads.

    Where there are subscribers is told to everyone with a role. Without that a publisher of the wrong role would keep
    its messages to itself, as Zenoh's do where they know of no reader, and nobody would ever see that it tried.
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
