"""Controller process: it publishes plans for the estimates of any publisher."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ltv_mpc import references
from ltv_mpc.bathymetry import bathymetry_for
from ltv_mpc.config import to_toml
from ltv_mpc.control.config import ControllerConfig, ResolvedConfig
from ltv_mpc.control.failed_qp import NamedQp
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.ocp import assembly
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers import Solver, make
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.control.solvers.recorder import QpRecorder, RecordingSolver
from ltv_mpc.geofence.fence import fence_for
from ltv_mpc.messages import (
    Action,
    Command,
    ControllerState,
    ControllerStatus,
    Estimate,
    Manual,
    Message,
    RejectedFrame,
    Solve,
    SolveStatus,
)
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Reference
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.options import BusOptions
from services.bus.topics import BY_TYPE, Topic
from services.processes import settings
from services.processes.checkpoint import Checkpoint
from services.run.settings_files import TOO_LARGE, controller_files, node_settings
from services.runtime import metrics as prometheus
from services.runtime.console import Console
from services.runtime.controller_status import ControllerStatusReporter, StatusSink, status_line
from services.runtime.lifeline import LIFELINE
from services.runtime.process_time import ClockOptions
from services.runtime.runner import Runner
from services.runtime.stage_timer import StageTimer
from services.runtime.stopping import FAILED, Say

Config = settings.Controller


def main(config: Config) -> int:
    """Run the controller node until it is stopped. Returns the exit code."""
    notes: list[str] = []
    vehicle, reference = Vehicle.load(config.vehicle), references.load(config.reference, notes)
    fence_file, soundings, arms_within_s = config.fence or "", config.bathymetry or "", config.arms_within_s
    fence = fence_for(vehicle, reference, fence_file, notes)
    control, bus = config.resolved(), config.bus
    bottom = bathymetry_for(reference, control.limits, soundings)
    metrics, console = prometheus.Metrics(), Console(ControllerNode.name, as_json=config.log_json)
    LIFELINE.connect(os.environ)
    with contextlib.ExitStack() as stack:
        if config.metrics is not None:
            try:
                stack.enter_context(prometheus.serving(metrics, config.metrics))
            except OSError as error:
                console.say(f"--metrics {config.metrics}: {error.strerror}")
                return FAILED
        checkpoint = None
        if config.state is not None:
            checkpoint = Checkpoint(config.state, to_toml(reference), resume_within_s=arms_within_s, console=console)
            stack.callback(checkpoint.close)
        LIFELINE.status("compiling")
        warm_up(vehicle, reference, control)
        LIFELINE.status("waiting for the router")
        node_stages = StageTimer()
        files = controller_files(config.vehicle, config.reference, fence_file, soundings, control)
        published = node_settings(ControllerNode.name, files)
        recorder = QpRecorder()
        make_solver = make if config.failed_qps is None else recorder
        node = ControllerNode(vehicle, reference, control, fence=fence, make_solver=make_solver, stopwatch=node_stages)
        if bottom is not None:
            node.controller.set_bathymetry(bottom)
        stack.callback(console.close)

        def show(status: ControllerStatus) -> None:
            line = status_line(status, key_in(bus, BY_TYPE[Estimate]))
            console.show(line)
            LIFELINE.status(line)

        for text in (
            *announcement(bus, control),
            *notes,
            *reference.notes(vehicle),
            *([TOO_LARGE] if published is None else []),
        ):
            console.say(text)
        shown: list[StatusSink] = [show, metrics.show]
        if checkpoint is not None:
            shown.append(checkpoint.show)
        if config.failed_qps is not None:
            shown.append(FailedQps(recorder, config.failed_qps, console.say).show)
        runner = Runner(
            node,
            clock=ClockOptions(sync_to_inputs=True, input_delay_ns=round(config.input_delay_s * 1e9)),
            compute_delay_ns=round(config.compute_delay_s * 1e9),
            stages=node_stages,
            report=ControllerStatusReporter(node, shown, console.tell, checkpoint),
            settings=published,
        )
        return runner.main(console, bus, checkpoint)


MAX_FAILED_QPS = 20
"""Largest number of files of one run: a failure that repeats every second gives no more information."""


class FailedQps:
    """Writer of failed QPs: between the cycles, at most one file each time the status is published."""

    def __init__(self, recorder: QpRecorder, folder: Path, say: Say, *, max_files: int = MAX_FAILED_QPS) -> None:
        """Write into ``folder`` what ``recorder`` keeps; ``say`` prints a line for a person."""
        self._recorder, self._folder, self._say, self._max_files = recorder, folder, say, max_files
        self._seen: NamedQp | None = None
        self.written = 0

    def show(self, status: ControllerStatus) -> None:
        """Write the last failed QP, if it was not written before."""
        failed = self._recorder.failed
        if failed is None or failed is self._seen or self.written >= self._max_files:
            return
        self._seen = failed
        path = self._folder / f"qp-{status.t_ns}.qp"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            failed.save(path)
        except OSError as error:
            self._say(f"a QP was not solved and cannot be saved in {self._folder}: {error.strerror}")
            return
        self.written += 1
        self._say(f"a QP was not solved ({failed.solve.why}); saved: ltv-mpc qp show {path}")


INTERNAL_TYPES = (ControllerState, RejectedFrame)
"""Messages that other publishers do not need: for a restarted controller, and the controller's own process."""


def key_in(bus: BusOptions, topic: Topic) -> str:
    """Return the key of a topic with the bus's namespace."""
    return f"{bus.namespace}/{topic.key}" if bus.namespace else topic.key


def announcement(bus: BusOptions, config: ResolvedConfig) -> Iterator[str]:
    """Generate the lines printed at the start: horizon and rate, then each key read or written with rate and fields."""
    horizon = f"{config.horizon_s:g} s in {config.stages} stages"
    yield f"horizon {horizon}, {1e9 / config.period_ns:.3g} cycles per second"
    yield "SI units and radians, north-east-down; each field name ends with its unit; `ltv-mpc topics KEY` lists them"
    inputs = [kind for kind in ControllerNode.reads if BY_TYPE[kind].written_by != ControllerNode.name]
    outputs: list[type[Message]] = [*ControllerNode.writes, ControllerStatus]
    inputs, outputs = ([kind for kind in kinds if kind not in INTERNAL_TYPES] for kinds in (inputs, outputs))
    for verb, kinds in (("reads ", inputs), ("writes", outputs)):
        for kind in kinds:
            topic = BY_TYPE[kind]
            period_ns = config.period_ns if topic.period_ns and topic.key == "plan" else topic.period_ns
            rate = f"{1e9 / period_ns:.3g} /s" if period_ns else "on events"
            yield f"{verb} {key_in(bus, topic):<24} {rate:<9}  {_fields(kind)}"


def _fields(kind: type[Message]) -> str:
    """Return the names of the required fields, then those of the optional fields in brackets."""
    fields = msgspec.structs.fields(kind)
    needed = ", ".join(field.name for field in fields if field.required)
    optional = ", ".join(field.name for field in fields if not field.required)
    return f"{needed} [{optional}]" if optional else needed


def warm_up(vehicle: Vehicle, reference: Reference, config: ControllerConfig) -> None:
    """Compile and load all code that a cycle can need, with the cycles of a temporary controller.

    Two cycles at the start of the reference; two far from it, where the line search shortens the step and the solver
    iterates; one whose solver fails; one with an estimate that is not finite; one under manual command; one after a gap
    in the estimates; and some without a new estimate, until hold and failsafe.
    """
    fails = False

    class FailingSolver(RecordingSolver):
        """Solver that fails on demand."""

        def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:
            result = super().solve(problem, shift, last=last)
            return result._replace(solve=Solve(status=SolveStatus.FAILED)) if fails else result

    def make_failing(*settings: Any) -> Solver:
        return FailingSolver(make(*settings))

    node = ControllerNode(vehicle, reference, config, make_solver=QpRecorder(make_failing))
    start_ns = 0 if reference.start_s is None else max(0, round(reference.start_s * 1e9))
    near = Estimate.at_rest(depth_m=0.0, heading_rad=1.0)
    far = Estimate.at_rest(depth_m=0.0, heading_rad=3.0, north_m=3.0, east_m=1.0)
    broken = Estimate.at_rest(depth_m=0.0, heading_rad=math.nan)
    others: dict[int, tuple[Message, ...]] = {
        0: (Command(command_id=0, action=Action.ARM, force=True),),
        6: (Command(command_id=1, action=Action.MANUAL), Manual(thrust_N=(1.0, 1.0, 0.0))),
    }
    for k, estimate in enumerate((near, near, far, far, far, broken, near, near)):
        gap_ns = 3_000_000_000 if k == 7 else 0  # too long for the bias of the current, which then only grows uncertain
        t_ns, fails = start_ns + k * config.period_ns + gap_ns, k == 4
        messages = (msgspec.structs.replace(estimate, t_ns=t_ns), *others.get(k, ()))
        node.step(t_ns, [ReceivedMessage(message, 1, k, t_ns) for message in messages])
    for missed_s in (2.0, 12.0, 30.0):  # prediction, hold, failsafe
        node.step(t_ns + round(missed_s * 1e9), [])


def warm_up_solver(vehicle: Vehicle, config: ResolvedConfig) -> None:
    """Compile what ``warm_up`` compiles last, so that two processes share the work."""
    solver, problem = make(vehicle, config), assembly.empty(config.stages)
    problem.H[:, :, :] = np.eye(problem.H.shape[1])
    solver.solve(problem, math.nan)
