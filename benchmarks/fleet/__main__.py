"""Number of vehicles that this machine can control: cost of each, and the resource that limits their number.

    .venv/bin/python -m benchmarks.fleet [--vehicles 1,10,100] [--processes P] [--json]

Runs the controllers, and one light process for all plants, over a router on loopback; estimators are not included.

    missed     estimates without a plan of their own in time
    latency    from an estimate's validity to its plan at the actuators; cycle: of one controller; both median / p99
    off        mean distance from the point to hold
    core each  processor time of one vehicle's controller, share of a core; then that of whole processes
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from types import SimpleNamespace

import msgspec

from benchmarks.fleet import trial
from benchmarks.fleet.fleet import Fleet
from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.terminal import progress_bar
from services.runtime.console import counted
from services.supervisor.loopback import free_port
from services.tools.profile import machine_description
from sim.evaluation.summary import Quantiles

HEADINGS = (
    "vehicles", "plans/s", "missed", "latency ms", "cycle ms", "off m", "core each", "controllers", "plants", "router",
    "first limit",
)  # fmt: skip


def text(rows: list[SimpleNamespace]) -> str:
    """Format a line for each trial."""
    lines = [HEADINGS, *(_cells(row) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADINGS))]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)


def _cells(row: SimpleNamespace) -> tuple[str, ...]:
    return (
        str(row.vehicles),
        f"{row.plans / row.seconds:.0f}",
        f"{100 * row.missed_share:.1f} %",
        _pair(row.latency_ms),
        _pair(row.cycle_ms),
        f"{row.mean_error_m:.3f}",
        f"{100 * row.controller_busy_per_vehicle:.2f} %",
        *(f"{100 * row.busy[name]:.0f} %" for name in ("controllers", "plants", "router")),
        row.limit,
    )


def _pair(of: Quantiles) -> str:
    return "-" if of.median is None or of.p99 is None else f"{of.median:.1f} / {of.p99:.1f}"


def main(words: Sequence[str] | None = None) -> int:
    """Run one trial for each number of vehicles; exit code 1 if a process ended without its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", default="1,10,100", metavar="N,...", help="one trial for each")
    parser.add_argument("--processes", type=int, default=1, help="of controllers")
    parser.add_argument("--rate-hz", type=float, default=10.0, help="cycles per second of each vehicle")
    parser.add_argument("--seconds", type=float, default=20.0, help="measured time of each trial")
    parser.add_argument("--warm-up-s", type=float, default=5.0, help="time before it")
    parser.add_argument("--horizon-s", type=float, help="default: of `vehicle check`")
    parser.add_argument("--vehicle", default="paper", metavar="NAME|FILE")
    parser.add_argument("--json", action="store_true")
    options = vars(parser.parse_args(words))
    as_json, numbers = options.pop("json"), options["vehicles"].split(",")
    try:
        Vehicle.load(options["vehicle"])
        fleets = [
            msgspec.convert({**options, "vehicles": number, "router": ""}, Fleet, strict=False) for number in numbers
        ]
    except (ConfigError, msgspec.ValidationError) as error:
        parser.error(str(error))
    load, rows = machine_description.load(), []
    for fleet in fleets:
        with progress_bar(counted(fleet.vehicles, "vehicle")) as progress:
            here = msgspec.structs.replace(fleet, router=f"tcp/127.0.0.1:{free_port()}")
            try:
                rows.append(trial.run(here, on_progress=progress))
            except trial.TrialFailed as error:
                sys.stderr.write(f"{error}\n")
                return 1
    result = {"rows": [vars(row) for row in rows], "machine": machine_description.machine(load)}
    print(msgspec.json.encode(result).decode() if as_json else text(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
