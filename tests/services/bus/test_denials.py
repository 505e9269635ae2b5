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


def test_a_put_is_counted_and_what_is_worked_out_ahead_is_not() -> None:
    denials = Denials()
    denials.read(log(*CACHING))
    assert denials.total == 0
    denials.read(
        log(
            f"{WHO} Put (ingress) on ns/plan",
            *["Using cached result: c0d0 is unauthorized to Put (ingress) on ns/plan"] * 3,
        )
    )
    assert denials.kinds == {"estimator may not put on ns/plan": 4}
    assert str(denials) == "estimator may not put on ns/plan (4)"


def test_what_one_thread_works_out_hides_no_attempt_that_another_hears() -> None:
    denials = Denials()
    denials.read(log(CACHING[0], thread=9) + log(f"{WHO} Put (ingress) on ns/plan") + log(*CACHING[1:], thread=9))
    assert denials.total == 1


def test_what_is_allowed_and_what_is_not_sent_out_are_no_attempts() -> None:
    denials = Denials()
    denials.read(log("Using cached result: c0d0 is authorized to Put (ingress) on ns/estimate"))
    denials.read(log("Using cached result: c0d0 is unauthorized to Put (egress) on ns/plan"))
    assert denials.total == 0


@pytest.mark.parametrize(
    ("reason", "kind"),
    [
        ("peer sent no certificates. Hint: increase the system open file limit.", "peer sent no certificates"),
        (
            "received fatal alert: DecryptError. Hint: increase the system open file limit.",
            "received fatal alert: DecryptError",
        ),
    ],
)
def test_a_refused_connection_is_counted_with_the_reason(reason: str, kind: str) -> None:
    denials = Denials()
    denials.read(f" WARN acc-0 ThreadId(05) zenoh_link_tls::unicast: {reason}\n".encode())
    assert denials.kinds == {f"connection: {kind}": 1}


def test_a_look_at_the_port_is_no_attempt_and_a_certificate_of_no_role_is_one() -> None:
    denials = Denials()
    denials.read(b" WARN acc-0 ThreadId(05) zenoh_link_tls::unicast: tls handshake eof. Hint: increase it.\n")
    assert denials.total == 0
    denials.read(
        log("a0b5 did not match any configured ACL subject. Default permission `Deny` will be applied on all messages")
    )
    assert denials.kinds == {"connection: a certificate without a known role": 1}


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
