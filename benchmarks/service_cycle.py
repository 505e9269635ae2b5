"""Computing time of a cycle in the controller process at 10 Hz, beside the library's cycle.

    .venv/bin/python -m benchmarks.service_cycle [--turns N] [--solver NAME] [--horizon-s H]

They take turns, so that all see the same load of the machine: seconds in which the process receives an estimate every
0.1 s, seconds in which the library has a cycle every 0.1 s, then a burst of cycles of the library at once. The vehicle
descends along the nominal model in all. A turn counts with its medians. The process's time is the sum of the stages in
``CycleTiming`` but "publish"; its stage "read" has the reading of messages, too. Other processes use the caches between
two cycles at 10 Hz, so these are cold, and those of a burst are not.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.latency import CLI, PATIENCE_S, awaited, started
from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, advance, references
from ltv_mpc.messages import Action, Command, CycleTiming, Plan
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.bus.wire import decode
from services.supervisor import loopback

PAPER = Vehicle.load("paper")
REFERENCE = references.load("descent")
PERIOD_S = 0.1
CYCLES = 30
"""Of a turn, each."""


class Service:
    """Loop around the controller process: estimates follow its plans."""

    def __init__(self, box: Mailbox, out: Outbox) -> None:
        self._box, self._out = box, out
        self._estimate = Estimate.at_rest()

    def arm(self) -> None:
        """Wait for the process, which compiles first, and arm it."""
        deadline = time.monotonic() + PATIENCE_S
        while awaited(self._box, "plan", PERIOD_S, []) is None:
            if time.monotonic() > deadline:
                sys.exit("no plan came")
            self._send()
        self._out.publish(Command(command_id=1, action=Action.ARM, force=True))

    def turn(self) -> float:
        """Return the median computing time of cycles in which the QP was solved (us)."""
        times = []
        for _ in range(CYCLES):
            due = time.monotonic() + PERIOD_S
            self._send()
            if frame := awaited(self._box, "plan", PERIOD_S, []):
                plan = decode(Plan, frame.payload)[0]
                self._estimate = advance(PAPER, self._estimate, plan, duration_s=PERIOD_S)
                if frame := awaited(self._box, "timing", due - time.monotonic(), []):
                    stages = decode(CycleTiming, frame.payload)[0].stage_us
                    if "solve" in stages:
                        times.append(sum(stages.values()) - stages.get("publish", 0.0))
            time.sleep(max(0.0, due - time.monotonic()))
        return float(np.median(times)) if times else np.nan

    def _send(self) -> None:
        self._estimate = msgspec.structs.replace(self._estimate, t_ns=time.time_ns())
        self._out.publish(self._estimate)


class Library:
    """Loop around a controller in this process."""

    def __init__(self, config: ControllerConfig) -> None:
        self._controller = Controller(PAPER, REFERENCE, config)
        self._estimate = Estimate.at_rest()

    def turn(self, *, paced: bool = False) -> float:
        """Return the median time of a cycle (us); ``paced``: of one every ``PERIOD_S``."""
        times = []
        for _ in range(CYCLES):
            due = time.monotonic() + PERIOD_S
            began = time.perf_counter()
            plan = self._controller.plan(self._estimate)
            times.append((time.perf_counter() - began) * 1e6)
            self._estimate = advance(PAPER, self._estimate, plan, duration_s=PERIOD_S)
            if paced:
                time.sleep(max(0.0, due - time.monotonic()))
        return float(np.median(times))


def main() -> None:
    """Measure and print a line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--solver", default="osqp")
    parser.add_argument("--horizon-s", type=float, help="default: the vehicle's own")
    options = parser.parse_args()
    config = ControllerConfig(solver=options.solver, horizon_s=options.horizon_s, period_s=PERIOD_S)
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    horizon = [] if options.horizon_s is None else ["--horizon-s", str(options.horizon_s)]
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "settings.toml"
        settings.write_text(f'solver = "{options.solver}"\nperiod_s = {PERIOD_S}\n')
        command = (*CLI, "controller", "--connect", endpoint, "--settings", str(settings), *horizon)
        with (
            started(*CLI, "router", "--listen", endpoint),
            started(*command),
            open_session(BusOptions(connect=(endpoint,)), stop=lambda: False, say=lambda _: None) as session,
        ):
            box = Mailbox()
            for key in ("plan", "timing"):
                session.subscribe(key, None, box)
            service = Service(box, Outbox(session, node="benchmark", epoch=1, kinds=(Estimate, Command)))
            service.arm()
            library = Library(config)
            for loop in (service, library):
                loop.turn()
            turns = np.array([(service.turn(), library.turn(paced=True), library.turn()) for _ in range(options.turns)])
    times = np.nanmedian(turns, axis=0)
    print(f"{options.solver}: process at 10 Hz {times[0]:.0f} us")
    for name, column in (("at 10 Hz", 1), ("in a burst", 2)):
        low, ratio, high = np.nanquantile(turns[:, 0] / turns[:, column], [0.25, 0.5, 0.75])
        print(f"library {name} {times[column]:.0f} us, ratio {ratio:.2f} ({low:.2f} to {high:.2f})")


if __name__ == "__main__":
    main()
