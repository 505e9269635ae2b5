"""What a secured router has denied, counted from Zenoh's own log: it drops in silence, and offers no other account.

Read are, of Zenoh 1.10, the lines of access control (trace), of which those that end a decision against a message that
came in count, and the warnings of TLS about connections that it has refused. Access control first works out, once for
each key and session, what would be allowed there; those lines are not attempts.
"""

from __future__ import annotations

import re
from collections import Counter

MODULE = "zenoh::net::routing::interceptor::access_control"

LOG_FILTER = f"warn,{MODULE}=trace"
"""What Zenoh has to log, in the words of RUST_LOG."""

TELLING = re.compile(rb"unauthorized|caching|did not match|zenoh_link_tls")
"""In every line that matters. Most of the log is of what was allowed, and is thrown away by the block."""

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
"""A connection that was closed without a word, as by whoever looks whether somebody listens: no attempt at anything."""

MOST_KINDS = 64
MOST_SESSIONS = 1024
LONGEST = 80


class Denials:
    """Counts by kind: who may not do what where. Whoever attempts chooses key and name, so their number is bounded."""

    def __init__(self) -> None:
        self.kinds: Counter[str] = Counter()
        self._names: dict[str, str] = {}  # by Zenoh id
        self._caching: dict[str, bool] = {}  # by thread: the lines that follow are of a permission worked out ahead
        self._rest = b""

    @property
    def total(self) -> int:
        """All of them."""
        return self.kinds.total()

    def read(self, block: bytes) -> None:
        """The next piece of the log, cut anywhere."""
        text, _, self._rest = (self._rest + block).rpartition(b"\n")
        if not TELLING.search(text):
            return
        for line in text.split(b"\n"):
            if TELLING.search(line):
                self._line(COLOUR.sub("", line.decode(errors="replace")))

    def __str__(self) -> str:
        """In words, the most frequent first."""
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
        if who is not None and (name := COMMON_NAME.search(who)) and len(self._names) < MOST_SESSIONS:
            self._names[zid] = name[1]
        if cached is None and self._caching.get(thread):
            self._caching[thread] = what != LAST_OF_CACHING
        elif flow == "ingress":
            self._count(f"{self._names.get(zid, zid)} may not {what.lower()} on {key}")

    def _count(self, kind: str) -> None:
        kind = "".join(c if c.isprintable() else "?" for c in kind)[:LONGEST]
        self.kinds[kind if kind in self.kinds or len(self.kinds) < MOST_KINDS else "others"] += 1
