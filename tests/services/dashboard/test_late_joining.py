"""Page that joins a run late: with the history of the recorder it shows what the verdict shows."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Estimate, Message, NodeStatus, Plan, RunEvent, Truth
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.roles import HISTORY
from services.bus.session import Reply, Session
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, to_map, unpack
from services.dashboard.bus_feed import BusFeed
from services.dashboard.late_joining import HistoryQuery
from services.recording.history import LIMIT, History, Part
from services.recording.segments import SegmentWriter
from services.runtime.recording_loop import RecordingLoop
from services.runtime.stopping import StopRequest
from sim.evaluation.metrics import RunMetrics
from tests.services.dashboard.synthetic_vehicle import sessions
from tests.services.reporting import synthetic_run
from tests.services.reporting.synthetic_run import CYCLE_NS, EPOCH, SPEED_NORTH_MPS, S
from tests.services.words import status
from tests.waiting import until

JOIN_S, END_S = 60, 62


@contextmanager
def recorder(bus: BusOptions, folder: Path, ashore: Session) -> Iterator[RecordingLoop]:
    """Record in a thread, from the first status of the recorder on."""
    stop, status = StopRequest(), Mailbox()
    ashore.subscribe("status/recorder", BY_TYPE[NodeStatus], status)
    with SegmentWriter(folder / "run.mcap", start_ns=-S, metadata={}) as writer:
        loop = RecordingLoop(writer, start_ns=-S, say=print)
        thread = threading.Thread(target=loop.serve, args=(bus, stop))
        thread.start()
        try:
            assert status.take(60.0) is not None
            yield loop
        finally:
            stop.request()
            thread.join()


class Publisher:
    """Publisher of the dive, up to any vehicle time."""

    def __init__(self, session: Session) -> None:
        self._dive = list(synthetic_run.dive(END_S))
        self.outs = synthetic_run.outboxes(session)
        self.estimate = synthetic_run.estimate(0)
        """Newest published estimate."""
        self._newest: dict[type[Message], tuple[str, Message]] = {}
        self._sent_s = time.monotonic()

    def publish(self, until_s: float) -> int:
        """Publish what is due and return the number of messages."""
        self._sent_s = time.monotonic()
        due = [one for one in self._dive if one[2] <= until_s * S]
        self._dive = self._dive[len(due) :]
        for node, signal, _ in due:
            self.outs[node].publish(signal)
            self._newest[type(signal)] = node, signal
            if isinstance(signal, Estimate):
                self.estimate = signal
        return len(due)

    def repeat(self) -> bool:
        """Publish the newest state again each second: with three sessions in one process messages are dropped."""
        if time.monotonic() > self._sent_s + 1.0:
            self._sent_s = time.monotonic()
            for kind in (Truth, Estimate, Plan):
                node, message = self._newest[kind]
                self.outs[node].publish(message)
        return False


@contextmanager
def recorded_dive(folder: Path, port: int) -> Iterator[tuple[Publisher, BusFeed, BusFeed]]:
    """Record a dive until ``JOIN_S``. Yield its publisher, a page that is older than the recorder, and a late one."""
    with sessions(port) as (aboard, ashore, reached):
        publisher, early = Publisher(aboard), BusFeed(ashore, Vehicle.load("paper"))
        until(lambda: publisher.outs["plant"].publish(status("plant")) or early.update() or early.status().processes)
        with recorder(reached, folder, ashore) as loop:
            until(lambda: is_recorded(loop, publisher))
            for second in range(JOIN_S + 1):  # all at once would be dropped by the full queues
                wanted = loop.received + publisher.publish(second)
                until(lambda wanted=wanted: loop.received >= wanted)  # type: ignore[misc]
            yield publisher, early, BusFeed(ashore, Vehicle.load("paper"))


def verdict() -> RunMetrics:
    metrics = RunMetrics(Vehicle.load("paper"))
    for sequence, (_, signal, _) in enumerate(synthetic_run.dive(END_S)):
        metrics.observe(signal, epoch=EPOCH, sequence=sequence)
    return metrics


def test_with_a_recorder_a_late_page_and_one_that_did_not_read_show_the_figures_of_the_verdict(
    tmp_path: Path, free_port: int
) -> None:
    """A busy machine kept the early page from reading. It asked for the history in vain before the recorder started."""
    with recorded_dive(tmp_path, free_port) as (publisher, early, late):
        follow(publisher, early, late)
        check_whole(late, publisher)
        check_whole(early, publisher)
    assert "arm accepted" in [mark.text for mark in early.collector.marks.marks]
    assert early.status().clock == "running"  # which the history has not


def check_whole(feed: BusFeed, publisher: Publisher) -> None:
    """Check that the page shows the figures of the verdict, and the dive from its start."""
    true = verdict().track.errors()["true_error_m"]
    shown = pytest.approx(true.final, abs=SPEED_NORTH_MPS * CYCLE_NS / S)  # the newest waits for a plan
    until(lambda: distance_m(feed) == shown or publisher.repeat())
    assert "since_s" not in feed.collector.values
    energy = feed.collector.tables["energy"].since(0)["all_J"][-1]
    assert energy == pytest.approx(verdict().commands.thrust().propulsive_energy_J, rel=0.02)
    track = feed.collector.tables["truth"].since(0)["t_s"]
    assert track == sorted(set(track))  # type: ignore[type-var]


def test_without_a_recorder_a_late_joiner_says_since_when_it_counts(free_port: int) -> None:
    with sessions(free_port) as (aboard, ashore, _):
        publisher = Publisher(aboard)
        publisher.publish(JOIN_S)
        feed = BusFeed(ashore, None)
        follow(publisher, feed)
    assert JOIN_S <= feed.collector.values["since_s"] <= END_S


def follow(publisher: Publisher, *feeds: BusFeed) -> None:
    """Publish the rest of the dive, and wait until each page has its last estimate."""
    publisher.publish(JOIN_S + 0.1)
    until(lambda: all(is_reached(feed, publisher) for feed in feeds))
    for tenth in range(JOIN_S * 10 + 2, END_S * 10 + 1):
        publisher.publish(tenth / 10)
        for feed in feeds:
            feed.update()
    until(lambda: all(is_at(feed, END_S * S) for feed in feeds) or publisher.repeat())


def distance_m(feed: BusFeed) -> float | None:
    """Return the distance of the vehicle from the reference that the page shows."""
    feed.update()
    return feed.status().true_error_m


def is_recorded(loop: RecordingLoop, publisher: Publisher) -> bool:
    """Publish a status; return True if the recorder has several, so that no later message is lost."""
    publisher.outs["plant"].publish(status("plant"))
    return loop.received >= 5


def is_reached(feed: BusFeed, publisher: Publisher) -> bool:
    """Publish a status and the newest estimate; return True if the page has both, so that no later message is lost."""
    publisher.outs["plant"].publish(status("plant"))
    publisher.outs["estimator"].publish(publisher.estimate)
    return is_at(feed, publisher.estimate.t_ns) and bool(feed.status().processes)


def is_at(feed: BusFeed, t_ns: int) -> bool:
    feed.update()
    estimate = feed.collector.newest(Estimate)
    return estimate is not None and estimate.t_ns >= t_ns


def long_dive() -> History:
    """Return the history of three hours of positions."""
    history = History()
    for t_ns in range(-S, 3 * 3600 * S, S // 5):
        history.add("truth", Truth, {"t_ns": t_ns, "epoch": EPOCH, "sequence": 0})
    return history


def parts(history: History) -> Iterator[list[tuple[str, bytes]]]:
    first: int | None = 0
    while first is not None:
        part = msgspec.msgpack.decode(history.reply(first), type=Part)
        first = part.next
        yield part.messages


def whole(history: History) -> list[tuple[str, bytes]]:
    return list(chain.from_iterable(parts(history)))


def test_the_history_is_bounded_and_keeps_the_start() -> None:
    payloads = [payload for _, payload in whole(long_dive())]
    assert LIMIT <= len(payloads) < 2 * LIMIT
    times = [unpack(payload)["t_ns"] for payload in payloads]
    assert 0 in times
    assert max(np.diff(times)) < 2 * 3 * 3600 * S / LIMIT


def test_all_parts_of_a_long_history_arrive(free_port: int) -> None:
    history, asked = History(), 0
    for i in range(LIMIT):
        for node in ("plant", "sensors", "estimator", "controller"):
            event = RunEvent(t_ns=i, node=node, kind="test", text="." * 2000)
            history.add(f"event/{node}", RunEvent, to_map(event, Header(epoch=EPOCH, sequence=i)))

    def answer(query: bytes, _: bytes, reply: Reply) -> None:
        nonlocal asked
        asked += 1
        reply(history.reply(msgspec.msgpack.decode(query)), None)

    with sessions(free_port) as (aboard, ashore, _):
        aboard.serve(HISTORY, answer)
        until(lambda: ashore.ask(HISTORY, msgspec.msgpack.encode(0), timeout_s=1.0) is not None)
        asked = 0
        query = HistoryQuery(ashore)
        until(lambda: not query.awaited)
    assert asked == len(list(parts(history))) > 30
    assert len(query.take()) == 4 * LIMIT
