"""Ports of the processes against the table of topics, which grants the rights to subscribe."""

from __future__ import annotations

import pytest

from ltv_mpc.messages import Clock
from ltv_mpc.node import Node
from services.bus.topics import BY_TYPE, TOPICS
from services.run.nodes import make_nodes
from services.run.run_config import resolve
from services.runtime import runner


@pytest.mark.parametrize("node", make_nodes(resolve("descent", [])), ids=lambda node: node.name)
def test_the_table_names_the_readers_of_each_topic(node: Node) -> None:
    read = set(node.reads) - {Clock}
    if node.name == BY_TYPE[Clock].written_by:
        read |= set(runner.CLOCK_MASTER_INPUTS)
    assert read == {topic.message_type for topic in TOPICS if node.name in topic.read_by}
