"""Download of mission and fence of an autopilot, by the mission protocol of MAVLink.

A request that has no answer within ``TIMEOUT_US`` is repeated; after ``TRIES`` the download is given up until the next
poll. A count during a download starts it again, a refusal (another station uploads) ends it. An item counts only if it
was the one that was asked for. A list may be replaced in the middle of a download without a sign, so one that differs
from the list in force is downloaded again, and counts once it has come twice: it is never a mixture of two.
"""

from __future__ import annotations

import enum
from typing import Any

from services.edges.edge import Refused

POLL_US, TIMEOUT_US, TRIES = 10_000_000, 1_500_000, 5
MAX_ITEMS = 500


class ListKind(enum.IntEnum):
    """Kind of a list of items (MAV_MISSION_TYPE)."""

    MISSION = 0
    FENCE = 1


class ListRefused(Refused):
    """Mission or fence that cannot be used. The ground station receives the reason."""


class Download:
    """Download of the items of one kind of list. ``items`` is the list in force."""

    def __init__(self, kind: ListKind) -> None:
        self._kind = kind
        self._due_us = self._tries = 0
        self._count: int | None = None  # of the list that is under way
        self._got: list[Any] = []
        self._seen: list[Any] | None = None  # list that has come once
        self._again = self._is_complete = False
        self.items: tuple[Any, ...] = ()

    def begin_again(self, now_us: int) -> None:
        """Ask for the list now; the same list counts as another one."""
        self._again, self._seen = True, None
        self._end(now_us)

    def request(self, make: Any, target: tuple[int, int], now_us: int) -> Any | None:
        """Return what is due, or None: the answer to a complete list, or a request."""
        if self._is_complete:
            self._is_complete = False
            return make.mission_ack_encode(*target, 0, self._kind)
        if now_us < self._due_us:
            return None
        if self._tries == TRIES:
            self._end(now_us + POLL_US)
            return None
        self._tries, self._due_us = self._tries + 1, now_us + TIMEOUT_US
        if self._count is None:
            return make.mission_request_list_encode(*target, self._kind)
        return make.mission_request_int_encode(*target, len(self._got), self._kind)

    def count(self, message: Any, now_us: int) -> bool:
        """Take a MISSION_COUNT. Return True if it empties the list. Raises ``ListRefused`` if it is too long."""
        if message.mission_type != self._kind:
            return False
        if message.count > MAX_ITEMS:
            self._end(now_us + POLL_US)
            raise ListRefused(f"{self._kind.name.lower()}: {message.count} items, at most {MAX_ITEMS}")
        self._end(now_us)
        self._count = message.count
        return self._is_another(now_us)

    def item(self, message: Any, now_us: int) -> bool:
        """Take a MISSION_ITEM_INT. Return True if it completes another list than the one in force."""
        if message.mission_type != self._kind or self._count is None or message.seq != len(self._got):
            return False
        self._got.append(message)
        self._tries, self._due_us = 0, now_us
        return self._is_another(now_us)

    def refusal(self, message: Any, now_us: int) -> None:
        """Take a MISSION_ACK: it ends a download that is under way, which is tried again soon."""
        if message.mission_type == self._kind and message.type != 0:
            self._end(now_us + TIMEOUT_US)

    def _is_another(self, now_us: int) -> bool:
        if self._count is None or len(self._got) < self._count:
            return False
        self._is_complete = True
        items, content = tuple(self._got), [_content(one) for one in self._got]
        another = self._again or content != [_content(one) for one in self.items]
        if another and content != self._seen:
            self._seen = content
            self._end(now_us + TIMEOUT_US)  # later than any answer that is still under way
            return False
        self._end(now_us + POLL_US)
        self._seen, self._again, self.items = None, False, items
        return another

    def _end(self, due_us: int) -> None:
        self._count, self._got, self._tries, self._due_us = None, [], 0, due_us


def _content(item: Any) -> tuple[str, ...]:
    fields = (item.command, item.frame, item.x, item.y, item.z, item.param1, item.param2, item.param3, item.param4)
    return tuple(map(repr, fields))  # by text, as NaN differs from itself
