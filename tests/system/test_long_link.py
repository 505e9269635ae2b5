"""The controller on another host than the vehicle: what a long and lossy link between them costs, in lock step."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

from benchmarks.faults.message_faults import Delivery, FaultyLockStep
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.validation import rejection_reason
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from sim.evaluation.metrics import RunMetrics
from sim.scheduler import LockStep, Observation

MS = 1_000_000
DELAY_NS, JITTER_NS, LOSS = 50 * MS, 20 * MS, 0.05
MIN_TIMEOUT_NS = 200 * MS  # Linux's smallest variance term: the timeout is the round trip and this


class LongLink:
    """TCP over a link that delays and loses what passes to and from the controller, and keeps the order.

    Each message takes 50 ms +- 20 ms. One that is lost, with a probability of 5 %, comes as long later as its sender
    needs to notice: its retransmission timeout, twice that if the second try is lost too. What follows waits behind it.
    """

    def __init__(self) -> None:
        self._rng = random.Random(0)
        self._free_ns: dict[bool, int] = {}
        self.delays_ns: list[int] = []

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:
        sent_ns = message.received_t_ns
        if (writer == "controller") == (reader == "controller"):
            return [Delivery(sent_ns, message)]
        stall_ns, timeout_ns = 0, 2 * DELAY_NS + MIN_TIMEOUT_NS
        while self._rng.random() < LOSS:
            stall_ns += timeout_ns
            timeout_ns *= 2
        at_ns = sent_ns + DELAY_NS + self._rng.randint(-JITTER_NS, JITTER_NS) + stall_ns
        at_ns = self._free_ns[writer == "controller"] = max(at_ns, self._free_ns.get(writer == "controller", 0))
        self.delays_ns.append(at_ns - sent_ns)
        return [Delivery(at_ns, message)]

    def receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:
        del reader
        return rejection_reason(delivery.message.message) or delivery.message


class Errors:
    """Observer of a run that evaluates it."""

    def __init__(self, metrics: RunMetrics) -> None:
        self._metrics = metrics

    def published(self, node: str, message: ReceivedMessage) -> None:
        del node
        self._metrics.observe(message.message, epoch=message.epoch, sequence=message.sequence)


def descent(link: Any = None) -> tuple[float, float]:
    """Return mean true distance from the reference (m) and median delay from estimate to effect (s), over 35 s."""
    run_config = resolve("descent", [Override("test", ["run.duration_s=35"])])
    metrics = RunMetrics(run_config.vehicle)
    nodes = make_nodes(run_config, publish_unread_topics=False)
    observation = Observation(Errors(metrics), types=metrics.message_types)
    settings: dict[str, Any] = {"start_ns": run_config.scenario.start_ns, "observation": observation}
    lockstep = LockStep(nodes, **settings) if link is None else FaultyLockStep(link, nodes, **settings)
    lockstep.advance(run_config.scenario.end_ns)
    mean_m, delay_s = metrics.track.errors()["true_error_m"].mean, metrics.delays.end_to_end().median
    assert mean_m is not None
    assert delay_s is not None
    return mean_m, delay_s


def test_the_mean_error_over_a_lossy_link_is_at_most_1_3_times_a_perfect_ones() -> None:
    link = LongLink()
    (ours_m, ours_s), (perfect_m, perfect_s) = descent(link), descent()
    assert max(link.delays_ns) > 6 * DELAY_NS  # something was lost
    assert ours_s > perfect_s + 0.1  # there and back
    assert ours_m <= 1.3 * perfect_m, f"{ours_m:.3f} m over the link, {perfect_m:.3f} m without"
