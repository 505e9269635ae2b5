"""Fences in random scenes: violations and arrivals.

    .venv/bin/python -m benchmarks.fences --out DIR [--scenes N] [--moving N] [--report-s S] [--workers N]

A scene is a point at the far end of a lane, 1 to 8 convex zones between (discs and polygons), a vehicle and a current
of up to half its top speed from any direction, which the controller knows. The gaps between the zones are at least 1.5
times hull, two margins and the drift of a turn into the current, as ``vehicle check`` counts it. With ``--moving`` an
obstacle crosses the lane instead, reported every 10 s or ``--report-s``. The vehicle moves as the model predicts, and
its clearance is taken every 0.1 s.

A scene counts as violated if the hull is in a zone at any time, and as arrived if the vehicle has come within its
length scale of the point. Scenes that DIR has already are not flown again. docs/notes/fences-study.md has the results,
also of rivals.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from benchmarks.batch import decode, keep_each
from benchmarks.fences.flight import MODELS, REPORT_S, Flown, Job, fly
from services.tools.batch.results_store import open_store


def table(found: dict[str, Flown]) -> str:
    """Return the table of violations and arrivals."""
    lines = [
        "| scenes | flown | violated | least clearance (m) | depth in a margin, 95 % (m) | arrived | "
        "median time (s) | cycles unsolved |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind in sorted({key.rsplit(" ", 1)[0] for key in found}, reverse=True):
        flown = [row for key, row in found.items() if key.rsplit(" ", 1)[0] == kind]
        least = np.array([row.clearance_m for row in flown])
        entered = np.quantile([row.entered_m for row in flown], 0.95)
        times = [row.duration_s for row in flown if row.arrived]
        unsolved, cycles = sum(len(row.unsolved_s) for row in flown), sum(row.cycles for row in flown)
        lines.append(
            f"| {kind} | {len(flown)} | {(least < 0.0).sum()} | {least.min():.3f} | {entered:.3f} | {len(times)} | "
            f"{np.median(times) if times else math.nan:.0f} | {unsolved} of {cycles} |"
        )
    return "\n".join(lines)


def remarkable(found: dict[str, Flown]) -> str:
    """Return the flights that violated, did not arrive, or had a cycle that was not solved."""
    lines = []
    for key, row in sorted(found.items()):
        if row.clearance_m < 0.0 or not row.arrived or row.unsolved_s:
            first = f", first at {row.unsolved_s[0]:.1f} s" if row.unsolved_s else ""
            lines.append(
                f"{key}: clearance {row.clearance_m:.3f} m, {'arrived' if row.arrived else 'not arrived'} "
                f"after {row.duration_s:.0f} s, {len(row.unsolved_s)} of {row.cycles} cycles unsolved{first}"
            )
    return "\n".join(lines)


def _key(job: Job) -> str:
    kind = "zones" if not job.moving else "moving" if job.report_s == REPORT_S else f"moving, {job.report_s:g} s"
    kind += "" if job.model == "right" else f", {job.model} model"
    return f"{kind} {job.seed}"


def main() -> None:
    """Fly, keep, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--moving", type=int, default=300)
    parser.add_argument("--report-s", type=float, default=REPORT_S, help="time between two reports of an obstacle")
    parser.add_argument("--model", choices=MODELS, default="right", help="how the true vehicle differs from its file")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    jobs = [Job(seed, False, model=options.model) for seed in range(options.scenes)]
    jobs += [Job(seed, True, options.report_s, options.model) for seed in range(options.moving)]
    with open_store(options.out, {"benchmark": "fences"}) as store:
        keep_each(fly, {_key(job): job for job in jobs}, store, workers=options.workers)
        found = {key: decode(flown, Flown) for key, flown in store.results()}
    print("\n\n".join(text for text in (table(found), remarkable(found)) if text))


if __name__ == "__main__":
    main()
