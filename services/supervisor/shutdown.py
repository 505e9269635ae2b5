"""Shutdown of a run: nodes first, then the recorder, so that it records their last messages, then the router.

A process that has not exited within its time is killed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from services.supervisor.managed_process import ManagedProcess

ORDERLY_S = 2.0  # for one node, after a complete run
ORDERLY_RECORDER_S = 10.0  # a slow disk
HASTY_S = (
    0.7  # for all nodes together, after Ctrl-C or a failure; with the two below, the whole shutdown takes at most 2 s
)
HASTY_RECORDER_S = 0.9
HASTY_ROUTER_S = 0.2


def stop(children: Mapping[str, ManagedProcess], *, in_order: bool, close_session: Callable[[], None]) -> list[str]:
    """Stop every process. Return the names of those that had to be killed.

    ``in_order``: stop one node after the other, so that each receives all messages of the one before; otherwise all at
    once. ``close_session`` closes the supervisor's own session, before the router stops.
    """
    nodes = [child for name, child in children.items() if name not in ("router", "recorder")]
    killed = []
    if not in_order:
        for child in nodes:
            child.terminate()
    until = time.monotonic() + HASTY_S
    for child in nodes:
        child.terminate()
        if not child.wait_or_kill(ORDERLY_S if in_order else until - time.monotonic()):
            killed.append(child.name)
    if "recorder" in children:
        children["recorder"].terminate()
        if not children["recorder"].wait_or_kill(ORDERLY_RECORDER_S if in_order else HASTY_RECORDER_S):
            killed.append("recorder")
    close_session()
    if "router" in children:
        children["router"].terminate()
        if not children["router"].wait_or_kill(ORDERLY_S if in_order else HASTY_ROUTER_S):
            killed.append("router")
    for child in children.values():
        child.close()
    return killed
