"""Benefit of the current preview: the error with the profile below the vehicle known, and without it.

    .venv/bin/python -m benchmarks.preview [--seeds N] [--workers N] [--out FILE.json]

The paper's descent with the state known, seeds 0 to N-1 (20). Without preview the controller is told the true current
at its own depth, in each cycle anew, and takes it to be the same at all others.
"""

from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.loop import Loop, Outcome, run_config
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.prediction import currents_at_depths
from ltv_mpc.messages import CurrentProfile, Estimate
from services.tools.batch.executor import run_each

HORIZONS_S = (2.5, 5.0, 10.0, 20.0)


class Job(NamedTuple):
    """One descent."""

    horizon_s: float
    preview: bool
    seed: int


def without_preview(estimate: Estimate) -> Estimate:
    """Return the estimate with the current of its own depth at all depths."""
    here = currents_at_depths(estimate.current, np.array([estimate.depth_m]))[0]
    everywhere = CurrentProfile(
        depth_m=np.array([0.0, 1.0]),
        north_mps=np.full(2, here[0]),
        east_mps=np.full(2, here[1]),
        sd_mps=np.zeros(2),
    )
    return msgspec.structs.replace(estimate, current=everywhere)


def one(job: Job) -> tuple[float, float, float]:
    """Mean distance (m), mean |F| (N), saturated share of the time."""
    s = run_config(f"run.seed={job.seed}", f"controller.horizon_s={job.horizon_s}")
    controller = Controller(s.vehicle, s.reference, s.scenario.controller)
    told = (lambda estimate: estimate) if job.preview else without_preview
    outcome: Outcome = Loop(run_config=s, controller=controller, told=told).fly()
    return outcome.mean_m, outcome.mean_abs_N, outcome.saturated


def main() -> None:
    """Run, print, and keep where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    jobs = [Job(h, preview, seed) for h in HORIZONS_S for preview in (True, False) for seed in range(options.seeds)]
    rows: dict[tuple[float, bool], list[tuple[float, float, float]]] = {}
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task(f"{len(jobs)} descents", total=len(jobs))
        for place, figures in run_each(one, jobs, workers=options.workers):
            rows.setdefault(jobs[place][:2], []).append(figures)
            progress.advance(task)
    means = {key: tuple(map(statistics.fmean, zip(*figures, strict=True))) for key, figures in rows.items()}
    print(f"| horizon, mean of {options.seeds} seeds | preview (m) | none (m) | ratio | abs F (N) | none: abs F (N) |")
    print("|---|---|---|---|---|---|")
    for h in HORIZONS_S:
        (error, force, _), (blind, blind_force, _) = means[h, True], means[h, False]
        print(f"| {h:g} s | {error:.3f} | {blind:.3f} | {blind / error:.1f} | {force:.1f} | {blind_force:.1f} |")
    if options.out is not None:
        options.out.write_text(
            json.dumps(
                [
                    {"horizon_s": h, "preview": p, "error_m": e, "abs_F_N": f, "saturated": s}
                    for (h, p), (e, f, s) in means.items()
                ],
                indent=1,
            )
            + "\n"
        )


if __name__ == "__main__":
    main()
