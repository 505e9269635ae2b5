"""The controller process: plans from estimates, whoever makes them."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from ltv_mpc import references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.scaling import resolve_weights
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.control.solvers import make
from ltv_mpc.messages import (
    Action,
    Command,
    ControllerState,
    ControllerStatus,
    Estimate,
    Manual,
    Message,
    Plan,
    PlanOrigin,
    Solve,
    SolveStatus,
)
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Reference
from ltv_mpc.safety import thrust_loss_detector
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.options import BusOptions
from services.bus.topics import BY_TYPE, Topic
from services.processes.failed_qps import FailedQps
from services.runtime import metrics as prometheus
from services.runtime.controller_status import ControllerStatusReporter, StatusSink
from services.runtime.process_time import ClockOptions
from services.runtime.runner import Runner
from services.runtime.serve import serve
from services.runtime.stage_timer import StageTimer
from services.runtime.status_line import StatusLine
from services.runtime.stopping import FAILED, Say, StopRequest, stderr_printer


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """What the controller process needs to start."""

    bus: BusOptions
    vehicle: str = "paper"  # NAME or FILE
    reference: str = "descent"  # NAME or FILE
    settings: ControllerConfig = ControllerConfig()
    compute_delay_s: float = 0.0  # added between a plan and its publication
    input_delay_s: float = 0.0  # the smallest delay of an estimate, which an exchange would measure
    metrics_port: int | None = None  # where on loopback the state is served
    failed_qps: Path | None = None  # where QPs that were not solved are kept


def main(config: Config) -> int:
    """Publish a plan each cycle."""
    vehicle, reference = Vehicle.load(config.vehicle), references.load(config.reference)
    settings, bus = config.settings, config.bus
    metrics = prometheus.Metrics()
    with contextlib.ExitStack() as stack:
        if config.metrics_port is not None:
            try:
                stack.enter_context(prometheus.serving(metrics, config.metrics_port))
            except OSError as error:
                stderr_printer(ControllerNode.name)(f"--metrics {config.metrics_port}: {error.strerror}")
                return FAILED
        warm_up(vehicle, reference, settings)
        node_stages = StageTimer()
        node = ControllerNode(vehicle, reference, settings, stopwatch=node_stages)
        line = StatusLine(node.name, key_in(bus, BY_TYPE[Estimate]), sys.stderr)
        stack.callback(line.close)

        def make(request: StopRequest, say: Say) -> Runner:
            say = line.saying(say)
            for text in (*announcement(bus, settings), *reference.notes(vehicle)):
                say(text)
            shown: list[StatusSink] = [line.show, metrics.show]
            if config.failed_qps is not None:
                shown.append(FailedQps(node.controller, config.failed_qps, say).show)
            return Runner(
                node,
                stop=request,
                say=say,
                clock=ClockOptions(sync_to_inputs=True, input_delay_ns=round(config.input_delay_s * 1e9)),
                compute_delay_ns=round(config.compute_delay_s * 1e9),
                stages=node_stages,
                report=ControllerStatusReporter(node, shown),
            )

        return serve(node.name, bus, make)


BEHIND_THE_SCENES = (ControllerState,)
"""Between a supervisor and the controller that it starts anew: nothing that a publisher needs to know of."""


def key_in(bus: BusOptions, topic: Topic) -> str:
    """The key as others see it."""
    return f"{bus.namespace}/{topic.key}" if bus.namespace else topic.key


def announcement(bus: BusOptions, config: ControllerConfig) -> Iterator[str]:
    """The keys that it reads and writes, with rates; each number's unit is in its field's name."""
    look = f"{config.horizon_s:g} s in {config.stages} stages"
    yield f"looks {look} ahead, {1e9 / config.period_ns:.3g} times a second"
    yield "SI units and radians, north-east-down; each field name ends with its unit; `ltv-mpc topics KEY` lists them"
    inputs = [kind for kind in ControllerNode.reads if BY_TYPE[kind].written_by != ControllerNode.name]
    outputs: list[type[Message]] = [*ControllerNode.writes, ControllerStatus]
    inputs, outputs = ([kind for kind in kinds if kind not in BEHIND_THE_SCENES] for kinds in (inputs, outputs))
    for verb, kinds in (("reads ", inputs), ("writes", outputs)):
        for kind in kinds:
            topic = BY_TYPE[kind]
            period_ns = config.period_ns if topic.period_ns and topic.key == "plan" else topic.period_ns
            rate = f"{1e9 / period_ns:.3g} /s" if period_ns else "on events"
            yield f"{verb} {key_in(bus, topic):<24} {rate:<9}  {_fields(kind)}"


def _fields(kind: type[Message]) -> str:
    """Those that a message needs, then in brackets those that it may have."""
    fields = msgspec.structs.fields(kind)
    needed = ", ".join(field.name for field in fields if field.required)
    optional = ", ".join(field.name for field in fields if not field.required)
    return f"{needed} [{optional}]" if optional else needed


def warm_up(vehicle: Vehicle, reference: Reference, config: ControllerConfig) -> None:
    """Have all compiled code and the solver loaded: some cycles of a controller that is thrown away.

    At the line; far off it, where the solver takes more than one turn and the step more than one try; with an estimate
    that is no number; with a pilot at the thrusters; on every rung below the solved plan; and with an estimate that is
    too old, where the vehicle is stopped and then left alone.
    """
    node = ControllerNode(vehicle, reference, config)
    begun = 0 if reference.start_s is None else max(0, round(reference.start_s * 1e9))
    here = Estimate.at_rest(depth_m=0.0, heading_rad=1.0)
    off = Estimate.at_rest(depth_m=0.0, heading_rad=3.0, north_m=3.0, east_m=1.0)
    broken = Estimate.at_rest(depth_m=0.0, heading_rad=math.nan)
    words: dict[int, tuple[Message, ...]] = {
        0: (Command(command_id=0, action=Action.ARM),),
        5: (Command(command_id=1, action=Action.MANUAL), Manual(thrust_N=(1.0, 1.0, 0.0))),
    }
    for k, estimate in enumerate((here, here, off, off, broken, here)):
        t_ns = begun + k * config.period_ns
        signals = (msgspec.structs.replace(estimate, t_ns=t_ns), *words.get(k, ()))
        node.steps([(t_ns, [ReceivedMessage(signal, 1, k, t_ns) for signal in signals])])
    node.controller.warm_up()
    thrust_loss_detector.warm_up()  # which these cycles, without a report of the actuators, have not asked for
    for missed_s in (2.0, 20.0):  # hold, and then failsafe
        node.steps([(t_ns + round(missed_s * 1e9), [])])


def warm_up_solver(vehicle: Vehicle, config: ControllerConfig) -> None:
    """Have compiled what ``warm_up`` comes to last: for a process that runs beside the one that does."""
    settings = resolve_weights(config, vehicle)
    solver, lin = make(vehicle, settings), Linearisation.empty(settings.stages)
    lin.flat[:] = 0.0
    solver.build(lin, np.zeros((settings.stages + 1, 2)))
    solver.update()
    solver.solve()
    plan = Plan(
        cycle_t_ns=0,
        t_ns=np.arange(2, dtype=np.int64),
        thrust_N=np.ones((2, 3)),
        states=np.zeros((2, 6)),
        origin=PlanOrigin.SOLVED,
        solve=Solve(status=SolveStatus.SOLVED),
    )
    SentCommands(vehicle).add(plan)
