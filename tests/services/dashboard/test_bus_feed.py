"""Bus connection of the live page: what it publishes, and when."""

from __future__ import annotations

from unittest.mock import MagicMock

from msgspec.structs import replace

from ltv_mpc.messages import Health, NodeStatus
from services.bus.topics import BY_TYPE, key_of
from services.bus.wire import Header, encode
from services.dashboard.bus_feed import BusFeed
from tests.services.reporting.synthetic_run import S, plan
from tests.services.words import status
from tests.waiting import until


def test_no_heartbeat_goes_out_before_a_process_of_the_run_is_known() -> None:
    """A recorder that starts after the page would count those before it as lost."""
    bus = MagicMock()
    bus.ask.return_value = None  # no recorder
    feed = BusFeed(bus, None)
    feed.beat()
    put = bus.publisher.return_value.put
    assert not put.called
    (inlet,) = (call.args[2] for call in bus.subscribe.call_args_list if call.args[1] is BY_TYPE[NodeStatus])
    frame = encode(status("recorder"), Header(epoch=1, sequence=0))
    inlet.offer(BY_TYPE[NodeStatus], key_of(NodeStatus, "recorder"), frame)
    until(lambda: feed.update() or feed.status().processes)
    feed.beat()
    assert put.call_count == 1


def test_the_status_says_since_when_the_health_has_its_reason() -> None:
    feed = BusFeed(MagicMock(**{"ask.return_value": None}), None)
    for t_s, why in ((1, ""), (2, "not driving"), (3, "not driving")):
        changed = replace(plan(t_s * S), health=Health.DEGRADED, health_why=why)
        feed.collector.add(changed, epoch=0)
    assert feed.status().health_s == feed.collector.seconds(2 * S)
