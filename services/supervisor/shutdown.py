"""The end of a run: nodes first, then the recorder, so that it hears the last word of all others, then the router."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from services.supervisor.managed_process import ManagedProcess

ORDERLY_S = 2.0  # for one node to stop at the end of a run
ORDERLY_RECORDER_S = 10.0  # a slow disk
HASTY_S = 0.7  # for all nodes together after Ctrl-C or a failure; with what follows, within 2 s in all
HASTY_RECORDER_S = 0.9
HASTY_ROUTER_S = 0.2


def stop(children: Mapping[str, ManagedProcess], *, in_order: bool, close_session: Callable[[], None]) -> list[str]:
    """Stop every child, by force where asking is not enough; the names of those that had to be killed.

    ``in_order``: one node after the other, so that each hears all that the one before it has said; else all at once.
    ``close_session`` ends the launcher's own listening, before the router goes.
    """
    nodes = [child for name, child in children.items() if name not in ("router", "recorder")]
    killed = []
    if not in_order:
        for child in nodes:
            child.ask_to_stop()
    until = time.monotonic() + HASTY_S
    for child in nodes:
        child.ask_to_stop()
        if not child.end(ORDERLY_S if in_order else until - time.monotonic()):
            killed.append(child.name)
    if "recorder" in children:
        children["recorder"].ask_to_stop()
        if not children["recorder"].end(ORDERLY_RECORDER_S if in_order else HASTY_RECORDER_S):
            killed.append("recorder")
    close_session()
    if "router" in children:
        children["router"].ask_to_stop()
        if not children["router"].end(ORDERLY_S if in_order else HASTY_ROUTER_S):
            killed.append("router")
    for child in children.values():
        child.close()
    return killed
