"""Bus connection of the live page: what it publishes, and when."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

from ltv_mpc.messages import Heartbeat, NodeStatus
from services.bus.mailbox import Mailbox
from services.bus.outbox import Outbox
from services.bus.session import FrameReceiver, Session
from services.bus.topics import BY_TYPE, Topic, key_of
from services.dashboard.bus_feed import BusFeed
from tests.services.words import status
from tests.waiting import until


class Bus:
    """Bus within this process: each frame goes to every receiver of its type at once."""

    def __init__(self) -> None:
        self._receivers: list[tuple[Topic | None, FrameReceiver]] = []

    def subscribe(self, _key: str, topic: Topic | None, receiver: FrameReceiver) -> None:
        self._receivers.append((topic, receiver))

    def ask(self, _key: str, _query: bytes, *, timeout_s: float) -> None:
        """Return no reply: there is no recorder."""
        assert timeout_s > 0

    def publisher(self, key: str) -> SimpleNamespace:
        def put(payload: bytes) -> None:
            for topic, receiver in self._receivers:
                if topic is not None and key.startswith(topic.key):
                    receiver.offer(topic, key, payload)

        return SimpleNamespace(put=put)


def test_no_heartbeat_goes_out_before_a_process_of_the_run_is_known() -> None:
    """A recorder that starts after the page would count those before it as lost."""
    bus = cast("Session", Bus())
    heartbeats = Mailbox()
    bus.subscribe(key_of(Heartbeat, "operator"), BY_TYPE[Heartbeat], heartbeats)
    feed = BusFeed(bus, None)
    feed.beat()
    assert not len(heartbeats)
    Outbox(bus, node="recorder", epoch=1, kinds=(NodeStatus,)).publish(status("recorder", t_ns=0))
    until(lambda: has_processes(feed))
    feed.beat()
    assert len(heartbeats) == 1


def has_processes(feed: BusFeed) -> bool:
    feed.update()
    return bool(feed.status().processes)
