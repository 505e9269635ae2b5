"""Denied attempts in a router's log: each counts once, with its client. The lines are those of Zenoh 1.10.2."""

from __future__ import annotations

import pytest

from services.bus.denials import MAX_KINDS, Denials

AC = "zenoh::net::routing::interceptor::access_control:"
HEAD = (
    "\x1b[2m2026-11-21T15:00:31.527361Z\x1b[0m \x1b[35mTRACE\x1b[0m rx-1 ThreadId({thread}) \x1b[2m" + AC + "\x1b[0m "
)
WHO = "c0d0 on Interface(lo)+CertCommonName(estimator)+Transport(Tls)+c0d0 is unauthorized to"
CACHING = (
    "ACL (ingress): caching permissions for `ns/plan` ...",
    f"{WHO} Query (ingress) on ns/plan",
    f"{WHO} Put (ingress) on ns/plan",
    f"{WHO} Delete (ingress) on ns/plan",
    f"{WHO} Declare Liveliness Subscriber (ingress) on ns/plan",
)


def log(*messages: str, thread: int = 10) -> bytes:
    return "".join(f"{HEAD.format(thread=thread)}{message}\n" for message in messages).encode()


PUT = f"{WHO} Put (ingress) on ns/plan"
CACHED = "Using cached result: c0d0 is"
LINK = " WARN acc-0 ThreadId(05) zenoh_link_tls::unicast: {}. Hint: increase the system open file limit.\n"
MAY_NOT = "estimator may not put on ns/plan"
NO_ROLE = "a0b5 did not match any configured ACL subject. Default permission `Deny` will be applied on all messages"


@pytest.mark.parametrize(
    ("lines", "kinds"),
    [
        (log(*CACHING), {}),  # worked out ahead
        (log(*CACHING, PUT, *[f"{CACHED} unauthorized to Put (ingress) on ns/plan"] * 3), {MAY_NOT: 4}),
        (log(CACHING[0], thread=9) + log(PUT) + log(*CACHING[1:], thread=9), {MAY_NOT: 1}),  # another thread
        (log(f"{CACHED} authorized to Put (ingress) on ns/estimate"), {}),
        (log(f"{CACHED} unauthorized to Put (egress) on ns/plan"), {}),  # not sent out
        (LINK.format("peer sent no certificates").encode(), {"connection: peer sent no certificates": 1}),
        (LINK.format("tls handshake eof").encode(), {}),  # a look at the port
        (log(NO_ROLE), {"connection: a certificate without a known role": 1}),
    ],
)
def test_each_attempt_is_counted_once_by_its_kind(lines: bytes, kinds: dict[str, int]) -> None:
    denials = Denials()
    denials.read(lines)
    assert denials.kinds == kinds
    assert str(denials) == ", ".join(f"{kind} ({count})" for kind, count in denials.kinds.items())


def test_lines_may_be_cut_anywhere() -> None:
    whole = log(*CACHING, f"{WHO} Put (ingress) on ns/plan")
    for cut in range(0, len(whole), 7):
        denials = Denials()
        denials.read(whole[:cut])
        denials.read(whole[cut:])
        assert denials.total == 1


def test_an_intruder_who_makes_up_keys_fills_no_memory() -> None:
    denials = Denials()
    for i in range(1000):
        denials.read(log(f"{WHO} Put (ingress) on made/up/{i}\x07{'x' * 500}"))
    assert denials.total == 1000
    assert len(denials.kinds) == MAX_KINDS + 1
    assert denials.kinds["others"] == 1000 - MAX_KINDS
    assert all(len(kind) <= 80 and kind.isprintable() for kind in denials.kinds)
