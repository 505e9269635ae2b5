"""Inject faults by the thousand and check the reactions; or inject faults on the bus, between two routers.

    .venv/bin/python -m benchmarks.faults [--n N] [--quick] [--where lockstep|processes] [--out DIR] [--json]
    .venv/bin/python -m benchmarks.faults inject NODE --to ENDPOINT [--connect ENDPOINT] [--fault FAULT ...]

Most faults are injected in lock step, one in five in real processes on a bus. Times and sizes are drawn from the seed.
Results are stored in DIR when a run ends, so a campaign can be interrupted and continued. Exit code 1: a requirement
failed, which is printed, or a fault could not be injected.

`inject` copies all messages between the routers and harms some of them: lost, delayed, reordered, doubled, damaged,
NaN, stale, or stamped by a clock that jumped. Faults come from --fault. Times are vehicle times.
Without faults it copies everything byte for byte.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.progress import Progress

from benchmarks.faults import campaign, inject
from benchmarks.faults.judge import UNFLAGGED_S, WAIT_S, FaultOutcome
from benchmarks.faults.kinds import NAMES, Place
from ltv_mpc.errors import ConfigError
from services.bus.options import BusOptions
from services.bus.roles import ROLES
from services.cli.options import check_endpoint, check_namespace
from services.runtime.console import columns, counted
from services.tools.batch.results_store import open_store

QUICK, FULL = 34, 1000
"""Default numbers of faults."""

MAX_SHOWN = 40
"""Violations that are printed; all of them are in faults.json."""


def _worst(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _median(values: Iterable[float | None]) -> float | None:
    known = sorted(value for value in values if value is not None)
    return known[len(known) // 2] if known else None


Outcomes = Sequence[FaultOutcome]
FIGURES: dict[str, tuple[str, Callable[[Outcomes], Any]]] = {
    "fault": ("fault", lambda seen: seen[0].fault.kind),
    "injected": ("n", len),
    "in_processes": ("proc", lambda seen: sum(one.place is Place.PROCESSES for one in seen)),
    "reaction_median_s": ("react s", lambda seen: _median(one.reaction_s for one in seen)),
    "reaction_worst_s": ("worst s", lambda seen: _worst(one.reaction_s for one in seen)),
    "worst_error_m": ("error m", lambda seen: _worst(one.worst_error_m for one in seen)),
    "worst_ratio": ("ratio", lambda seen: _worst(one.ratio for one in seen)),
    "grown_m": ("moved m", lambda seen: _worst(one.grown_m for one in seen if one.bound_m is not None)),
    "bound_m": ("bound m", lambda seen: _worst(one.bound_m for one in seen)),
    "late": ("late", lambda seen: sum(bool(one.late) for one in seen)),
    "not_recovered": (">2", lambda seen: sum(not one.recovered for one in seen)),
    "beyond_bound": (">bound", lambda seen: sum(one.beyond_bound for one in seen)),
    "unflagged": ("unflagged", lambda seen: sum(one.outside_s > UNFLAGGED_S for one in seen)),
    "uncounted": ("lost", lambda seen: sum(one.uncounted for one in seen)),
    "bad_thrusts": ("bad", lambda seen: sum(one.bad_thrusts for one in seen)),
    "false_figures": ("false", lambda seen: sum(bool(one.false_figures) for one in seen)),
    "waits": (">10 s", lambda seen: sum((one.wait_s or 0.0) > WAIT_S for one in seen)),
    "uncontrolled": ("out", lambda seen: sum(bool(one.uncontrolled) for one in seen)),
}
"""Figures of a fault class, with their headings. None: not measured."""

COUNTS = ("injected", "in_processes", *list(FIGURES)[9:])
"""Figures that are summed over all classes."""


def summary(seen: Outcomes) -> dict[str, Any]:
    """Return the content of faults.json: sums over all faults, a row for each class, and the violations."""
    classes = [of for name in NAMES if (of := [one for one in seen if one.fault.kind == name])]
    rows = [{name: of(one) for name, (_, of) in FIGURES.items()} for one in classes]
    sums = {name: sum(row[name] for row in rows) for name in COUNTS}
    return {"classes": len(rows), **sums, "rows": rows, "violations": [one for one in seen if one.problems]}


def table(of: dict[str, Any]) -> str:
    """Format a line for each class, the sums, and the violated requirements."""
    rows = [*of["rows"], {**dict.fromkeys(FIGURES, ""), **of, "fault": "all"}]
    lines = [[heading for heading, _ in FIGURES.values()], *([_figure(row[name]) for name in FIGURES] for row in rows)]
    text = columns(lines, numbers=True)
    for seen in of["violations"][:MAX_SHOWN]:
        fault = seen.fault
        where = f"{fault.kind} {fault.target}, {seen.place}, seed {seen.run_seed}"
        when = f"{fault.start_s:.1f} to {fault.end_s:.1f} s, size {fault.size:.3g}"
        text.append(f"requirement failed: {where}, {when}: {'; '.join(seen.problems)}")
    return "\n".join(text)


def _figure(value: float | str | None) -> str:
    return "-" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)


def main(words: Sequence[str] | None = None) -> int:
    """Make the campaign, or inject faults on the bus."""
    words = sys.argv[1:] if words is None else words
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    try:
        return _inject(parser, words[1:]) if words[:1] == ["inject"] else _campaign(parser, words)
    except ConfigError as error:
        parser.error(str(error))


def _campaign(parser: argparse.ArgumentParser, words: Sequence[str]) -> int:
    parser.add_argument("--n", type=int, help=f"number of faults; default {FULL}, quick {QUICK}")
    parser.add_argument("--classes", default="", metavar="NAME,...", help="only these; an unknown name lists them")
    parser.add_argument("--seed", type=int, default=0, help="of times, sizes and scenarios")
    parser.add_argument("--quick", action="store_true", help="safety and reactions only, not the errors a minute later")
    parser.add_argument("--where", choices=("both", *Place), default="both")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep the results; continue those that are there")
    parser.add_argument("--force", action="store_true", help="replace what is in that folder")
    options = parser.parse_args(words)
    n, out, started = options.n or (QUICK if options.quick else FULL), options.out, time.monotonic()
    asked = campaign.plan(options.classes, options.where, n, seed=options.seed, quick=options.quick)
    with (
        tempfile.TemporaryDirectory() if out is None else nullcontext(out) as place,
        open_store(Path(place), asked.settings, force=options.force) as store,
        Progress(console=Console(stderr=True)) as progress,
    ):
        task = progress.add_task(counted(asked.total, "fault"), total=asked.total)
        seen = campaign.run(asked, store, progress=lambda count: progress.advance(task, count))
    of = summary(seen)
    # Of the machine over its last minute, for each core: what is asked by the wall needs one below 1.
    load, wall_s = os.getloadavg()[0] / (os.cpu_count() or 1), time.monotonic() - started
    of |= {"seed": asked.seed, "quick": asked.quick, "wall_s": wall_s, "load": load}
    plain = msgspec.json.format(msgspec.json.encode(of), indent=2).decode()
    print(plain if options.json else table(of))
    if out is not None:
        (out / "faults.json").write_text(plain + "\n", encoding="utf-8")
    if missing := asked.total - len(seen):
        sys.stderr.write(f"{missing} of {counted(asked.total, 'fault')} not injected: the run ended first\n")
    return 1 if of["violations"] or missing else 0


def _inject(parser: argparse.ArgumentParser, words: Sequence[str]) -> int:
    parser.add_argument("node", choices=ROLES, metavar="NODE", help="under test, the only one at router B")
    parser.add_argument("--to", required=True, metavar="ENDPOINT", help="router B")
    parser.add_argument("--connect", metavar="ENDPOINT", help="router A; default tcp/127.0.0.1:7447")
    parser.add_argument("--fault", action="append", default=[], metavar="FAULT", help=inject.WORDS)
    parser.add_argument("--link", default="", metavar="FILE", help="record the frames that differ beyond the injector")
    parser.add_argument("--namespace", default="")
    parser.add_argument("--certs", type=Path, metavar="DIR", help="use mTLS with these certificates")
    options = parser.parse_args(words)
    check_namespace(options.namespace)
    for option, endpoint in (("--to", options.to), ("--connect", options.connect)):
        if endpoint is not None:
            check_endpoint(option, endpoint, options.certs)
    common = {"mode": "client", "namespace": options.namespace, "certs": options.certs, "role": inject.NAME}
    at_a, at_b = (BusOptions(connect=(place,) if place else (), **common) for place in (options.connect, options.to))
    injections = tuple(inject.parse(text) for text in options.fault)
    return inject.main(inject.Config(node=options.node, injections=injections, at_a=at_a, at_b=at_b, link=options.link))


if __name__ == "__main__":
    sys.exit(main())
