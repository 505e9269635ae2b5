"""What a process that is started anew is told: the newest checkpoint, and what is in force at the actuators.

Nobody else writes these while the process is dead, so what is handed over with its start is what there is.
"""

from __future__ import annotations

import msgspec

from ltv_mpc.messages import ControllerCheckpoint, Estimate, EstimatorCheckpoint, Restore
from services.bus.wire import Header, encode
from services.launch.watch import Watch


def restore_of(node: str, watch: Watch) -> bytes:
    """As it travels; empty where there is nothing to go on from."""
    restore = Restore(t_ns=watch.t_ns() or 0, node=node, estimate=watch.newest(Estimate))
    match node:
        case "controller":
            plan, checkpoint = watch.plan_in_force(), watch.newest(ControllerCheckpoint)
            restore = msgspec.structs.replace(restore, plan=plan, controller=checkpoint)
        case "estimator":
            restore = msgspec.structs.replace(restore, estimator=watch.newest(EstimatorCheckpoint))
        case _:
            return b""
    if restore.plan is None and restore.controller is None and restore.estimator is None:
        return b""
    return encode(restore, Header(epoch=0, sequence=0))
