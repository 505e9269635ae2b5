"""Download of a list by the mission protocol: losses, reordering, and lists that change on the way."""

from __future__ import annotations

import heapq
import random
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="not installed: pip install pymavlink (extra mavlink)")

from services.edges.mavlink.download import MAX_ITEMS, Download, ListKind, ListRefused

STEP_US, LIMIT_US = 100_000, 600_000_000


def item(seq: int, x: int, kind: int = 0) -> Any:
    zero = dict.fromkeys(("z", "param1", "param2", "param3", "param4"), 0.0)
    return SimpleNamespace(seq=seq, mission_type=kind, command=16, frame=6, x=x, y=0, **zero)


def count(number: int, kind: int = 0) -> Any:
    return SimpleNamespace(count=number, mission_type=kind)


MAKE = SimpleNamespace(
    mission_request_list_encode=lambda *of: ("list", 0, of[2]),
    mission_request_int_encode=lambda *of: ("item", *of[2:]),
    mission_ack_encode=lambda *of: ("ack", *of[2:]),
)
"""Encoder whose messages are tuples."""


class ArduPilot:
    """List of ArduPilot: an upload replaces it item by item, and requests are refused meanwhile."""

    def __init__(self, items: list[int]) -> None:
        self.items = items
        self.upload: list[int] = []

    def begin(self, items: list[int]) -> None:
        self.upload, self.items = list(items), self.items[: len(items)]
        self.at = 0

    def advance(self) -> None:
        if self.upload:
            self.items[self.at : self.at + 1] = [self.upload[self.at]]
            self.at += 1
            self.upload = self.upload if self.at < len(self.upload) else []

    def answer(self, request: tuple[str, int, int]) -> Any:
        what, seq, kind = request
        if what == "ack":
            return None
        if self.upload or (what == "item" and seq >= len(self.items)):
            return SimpleNamespace(type=14 if self.upload else 13, mission_type=kind)
        return count(len(self.items), kind) if what == "list" else item(seq, self.items[seq], kind)


def test_with_losses_and_in_any_order_the_newest_list_comes_whole() -> None:
    """Three hundred schedules: 30 % of the frames lost each way, answers up to 1 s late, three lists on the way."""
    for seed in range(300):
        rng = random.Random(seed)
        lists = [[1000 * k + at for at in range(rng.choice((4, 4, 8, 2)))] for k in range(1, 5)]
        changes = sorted(rng.sample(range(10, 400), 3))  # steps
        autopilot, download, air = ArduPilot(lists[0]), Download(ListKind.MISSION), list[tuple[int, int, Any]]()
        known, step = [tuple(lists[0])], 0
        while step < LIMIT_US // STEP_US:
            now_us = step * STEP_US
            if changes and step >= changes[0] and not autopilot.upload:
                del changes[0]
                known.append(tuple(lists[len(known)]))
                autopilot.begin(list(known[-1]))
            autopilot.advance()
            request = download.request(MAKE, (1, 1), now_us)
            if request is not None and rng.random() >= 0.3:
                answer = autopilot.answer(request)
                if answer is not None and rng.random() >= 0.3:
                    late_us = rng.choice((0, STEP_US, rng.randrange(1_000_000)))
                    heapq.heappush(air, (now_us + late_us, step, answer))
            while air and air[0][0] <= now_us:
                _, _, message = heapq.heappop(air)
                if hasattr(message, "type"):
                    download.refusal(message, now_us)
                elif (download.count if hasattr(message, "count") else download.item)(message, now_us):
                    assert tuple(one.x for one in download.items) in known, seed
            if not changes and not autopilot.upload and [one.x for one in download.items] == autopilot.items:
                break
            step += 1
        assert [one.x for one in download.items] == autopilot.items, seed


def receive(download: Download, numbers: list[int], now_us: int) -> bool:
    """Pass a list to the download, as answers to its requests. Return True if it is another list."""
    another = download.count(count(len(numbers)), now_us)
    for seq, x in enumerate(numbers):
        assert download.request(MAKE, (1, 1), now_us) == ("item", seq, 0)
        another = download.item(item(seq, x), now_us)
    if another or numbers:
        assert download.request(MAKE, (1, 1), now_us) == ("ack", 0, 0)
    return another


def test_a_list_counts_once_it_has_come_twice_and_the_same_list_is_no_other() -> None:
    download = Download(ListKind.MISSION)
    assert download.request(MAKE, (1, 1), 0) == ("list", 0, 0)
    assert not receive(download, [1, 2], 0)
    assert download.items == ()
    assert download.request(MAKE, (1, 1), 1_400_000) is None
    assert download.request(MAKE, (1, 1), 1_500_000) == ("list", 0, 0)
    assert receive(download, [1, 2], 1_500_000)
    assert not receive(download, [1, 2], 12_000_000)
    assert not receive(download, [1, 3], 23_000_000)  # half of another list, perhaps
    assert not receive(download, [4, 3], 25_000_000)
    assert [one.x for one in download.items] == [1, 2]
    assert receive(download, [4, 3], 27_000_000)
    download.begin_again(30_000_000)
    assert download.request(MAKE, (1, 1), 30_000_000) == ("list", 0, 0)
    assert not receive(download, [4, 3], 30_000_000)
    assert receive(download, [4, 3], 32_000_000)


def test_a_count_during_a_download_begins_it_anew() -> None:
    download = Download(ListKind.MISSION)
    for _ in range(2):
        download.count(count(8), 0)
        for seq in range(4):
            download.item(item(seq, seq), 0)
        assert not receive(download, [7, 8, 9, 10], 0) or [one.x for one in download.items] == [7, 8, 9, 10]
    assert [one.x for one in download.items] == [7, 8, 9, 10]


def test_a_request_is_sent_five_times_every_1_5_s_and_then_again_after_ten_seconds() -> None:
    download = Download(ListKind.FENCE)
    download.count(count(3, 1), 0)
    sent = [k for k in range(200) if download.request(MAKE, (1, 1), 100_000 * k) == ("item", 0, 1)]
    assert sent == [0, 15, 30, 45, 60]
    assert download.request(MAKE, (1, 1), 17_600_000) is None  # the time began with the end of the last try, at 7.5 s
    download = Download(ListKind.FENCE)
    sent = [k for k in range(200) if download.request(MAKE, (1, 1), 100_000 * k) == ("list", 0, 1)]
    assert sent == [0, 15, 30, 45, 60, 175, 190]


def test_other_kinds_of_lists_and_items_that_were_not_asked_for_do_not_count() -> None:
    download = Download(ListKind.MISSION)
    assert not download.item(item(0, 1), 0)
    download.count(count(2), 0)
    for other in (item(1, 1), item(0, 1, kind=1)):
        download.item(other, 0)
    assert download.request(MAKE, (1, 1), 0) == ("item", 0, 0)
    with pytest.raises(ListRefused, match=f"mission: {MAX_ITEMS + 1} items"):
        download.count(count(MAX_ITEMS + 1), 0)


def test_a_refusal_ends_the_download_and_the_list_is_asked_for_again_soon() -> None:
    download = Download(ListKind.MISSION)
    download.count(count(2), 0)
    download.item(item(0, 1), 0)
    download.refusal(SimpleNamespace(type=14, mission_type=1), 0)  # of another list
    assert download.request(MAKE, (1, 1), 0) == ("item", 1, 0)
    download.refusal(SimpleNamespace(type=14, mission_type=0), 0)
    assert download.request(MAKE, (1, 1), 1_400_000) is None
    assert download.request(MAKE, (1, 1), 1_500_000) == ("list", 0, 0)
