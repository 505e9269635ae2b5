"""Denied access at a secured router, counted from Zenoh's log.

Zenoh drops denied messages without a report, so its log is the only source. Two kinds of lines of Zenoh 1.10 count:
the lines of access control (trace level) that end a decision against an incoming message, and the warnings of TLS about
rejected connections. Access control first caches, once for each key and session, what would be allowed there; those
lines are no attempts.
"""

from __future__ import annotations

import re
from collections import Counter

MODULE = "zenoh::net::routing::interceptor::access_control"

LOG_FILTER = f"warn,{MODULE}=trace"
"""Log filter that Zenoh needs, in the syntax of RUST_LOG."""

RELEVANT = re.compile(rb"unauthorized|caching|did not match|zenoh_link_tls")
"""Pattern of every line that matters. Most lines are about allowed access; blocks without a match are skipped whole."""

COLOUR = re.compile(r"\x1b\[[0-9;]*m")
THREAD = re.compile(r"ThreadId\((\d+)\)")
CACHING = re.compile(r"ACL \((?:ingress|egress)\): caching")
LAST_OF_CACHING = "Declare Liveliness Subscriber"
DENIED = re.compile(
    r"access_control: (Using cached result: )?(\w+)(?: on (\S+))? is unauthorized to (.+) \((\w+)\) on (.*)$"
)
COMMON_NAME = re.compile(r"CertCommonName\(([^)]*)\)")
WITHOUT_ROLE = re.compile(r"access_control: (\w+) did not match any configured ACL subject")
REFUSED_LINK = re.compile(r"zenoh_link_tls\S*: (.+?)(?:\. Hint: .*)?$")

SILENT = "tls handshake eof"
"""Reason of a connection that was closed at once, as by a port check: no attempt at access."""

MAX_KINDS = 64
MAX_SESSIONS = 1024
MAX_TEXT = 80
"""Length of one kind (characters)."""


class Denials:
    """Denials by kind: who may not do what on which key. A client chooses key and name, so their number is bounded."""

    def __init__(self) -> None:
        self.kinds: Counter[str] = Counter()
        self._names: dict[str, str] = {}  # by Zenoh id
        self._caching: dict[str, bool] = {}  # by thread: True while its lines are about what is cached ahead
        self._rest = b""

    @property
    def total(self) -> int:
        """Number of all denials."""
        return self.kinds.total()

    def read(self, block: bytes) -> None:
        """Read the next piece of the log, which may end within a line."""
        text, _, self._rest = (self._rest + block).rpartition(b"\n")
        if not RELEVANT.search(text):
            return
        for line in text.split(b"\n"):
            if RELEVANT.search(line):
                self._line(COLOUR.sub("", line.decode(errors="replace")))

    def __str__(self) -> str:
        """Describe the most frequent kinds."""
        return ", ".join(f"{kind} ({count})" for kind, count in self.kinds.most_common(3))

    def _line(self, line: str) -> None:
        thread = match[1] if (match := THREAD.search(line)) else ""
        if CACHING.search(line):
            self._caching[thread] = True
        elif match := DENIED.search(line):
            self._decided(thread, *match.groups())
        elif match := WITHOUT_ROLE.search(line):
            self._count("connection: a certificate without a known role")
        elif (match := REFUSED_LINK.search(line)) and match[1] != SILENT:
            self._count(f"connection: {match[1]}")

    def _decided(
        self, thread: str, cached: str | None, zid: str, who: str | None, what: str, flow: str, key: str
    ) -> None:
        if who is not None and (name := COMMON_NAME.search(who)) and len(self._names) < MAX_SESSIONS:
            self._names[zid] = name[1]
        if cached is None and self._caching.get(thread):
            self._caching[thread] = what != LAST_OF_CACHING
        elif flow == "ingress":
            self._count(f"{self._names.get(zid, zid)} may not {what.lower()} on {key}")

    def _count(self, kind: str) -> None:
        kind = "".join(c if c.isprintable() else "?" for c in kind)[:MAX_TEXT]
        self.kinds[kind if kind in self.kinds or len(self.kinds) < MAX_KINDS else "others"] += 1
