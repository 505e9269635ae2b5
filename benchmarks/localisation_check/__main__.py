"""Localisation check over many seeds: drift relative to its bound, and consistency of errors with the covariance.

    .venv/bin/python -m benchmarks.localisation_check [--runs N] [--sensors NAME|FILE] [--out DIR] [--json]

Closed-loop runs in lock step on all cores. Exit code 1: a figure is outside its limits, at a family-wise level of 1 %:
a good filter fails one check in a hundred.

    drift      of one horizontal axis over the descent, rms over runs and both axes; the bound (posterior Cramer-Rao)
               is that of each run
    per dof    mean NEES of a quantity or NIS of a sensor, with its standard error over the runs
    in band    share of instants at which their sum over the runs lies in the 95 % band of chi-square; judged only if a
               run has enough independent draws over time
    slope, R2  of the final drift against the velocity error at submergence, through the origin, both axes

``judgement.py`` says when a figure is outside its limit.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import msgspec

from benchmarks.localisation_check import check
from benchmarks.localisation_check.judgement import MIN_DRAWS
from ltv_mpc.errors import ConfigError
from services.tools.batch.results_store import open_store


def table(of: SimpleNamespace) -> str:
    """Format the result as text."""
    low, high = of.ratio_at_bound
    lines = [
        f"{of.runs} runs of {of.scenario}, sensors {of.sensors}, {of.surface_time_s:g} s afloat, "
        f"seeds {of.first_seed} to {of.first_seed + of.runs - 1}, {of.wall_s:.0f} s",
        f"drift     {of.drift_rms_m:.3f} m an axis, bound {of.bound_rms_m:.3f} m, ratio {of.ratio:.2f} "
        f"(at the bound: {low:.2f} to {high:.2f})",
        f"vehicle   {of.true_error_m:.3f} m from the line, mean over time and runs",
        f"velocity  {1e3 * of.velocity_error_rms_mps:.2f} mm/s at submergence, sigma of the filter "
        f"{1e3 * of.velocity_reported_rms_mps:.2f}, bound {1e3 * of.velocity_bound_rms_mps:.2f}; "
        f"drift = {of.slope_s:.0f} s x velocity error, R2 {of.r2:.2f}",
        f"judged at a family-wise level of {100 * of.family_wise_level:g} % (Holm), {len(of.hypotheses)} hypotheses",
        f"{'':<24} {'per dof':>8} {'+-':>6} {'p':>6} {'in 95 % band':>12}",
    ]
    p = {one.name: one.p for one in of.hypotheses}
    for kind, quantities in (("NEES", of.nees), ("NIS", of.nis)):
        for one in quantities:
            mean = f"{one.per_dof:8.2f} {one.standard_error:6.2f} {p[check.mean_name(kind, one.name)]:6.2f}"
            judged = f"{100 * one.in_band:>10.0f} %" if one.draws >= MIN_DRAWS else f"{'few draws':>12}"
            lines.append(f"{kind:<4} {one.name:<19} {mean} {judged}")
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    """Make the runs, print the figures, and write them where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, help="one seed each; at least 2")
    parser.add_argument("--sensors", default="paper", metavar="NAME|FILE")
    parser.add_argument("--surface-time-s", default="1", metavar="S", help="time afloat: one TDCP fix a second")
    parser.add_argument("--seed", type=int, default=0, help="the first")
    parser.add_argument("--scenario", default="descent", metavar="NAME|FILE")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, help="folder of localisation-check.json; its runs are used again")
    parser.add_argument("--force", action="store_true", help="replace what is in that folder")
    options = parser.parse_args(words)
    if options.runs < 2:
        parser.error(f"--runs: {options.runs}: must be >= 2")
    settings = (f"sensors={options.sensors}", f"run.surface_time_s={options.surface_time_s}")
    started, out = time.monotonic(), options.out
    try:
        jobs = check.jobs(options.scenario, settings, first_seed=options.seed, runs=options.runs)
        made_of = dict(jobs[0].run_config().files)
        with (
            tempfile.TemporaryDirectory() if out is None else nullcontext(out) as place,
            open_store(Path(place), made_of, force=options.force) as store,
        ):
            records = check.measure(jobs, store)
    except ConfigError as error:
        parser.error(str(error))
    result = check.result(records, jobs, wall_s=time.monotonic() - started)
    plain = msgspec.json.format(msgspec.json.encode(vars(result)), indent=2).decode()
    problems = check.failed(result)
    print(plain if options.json else table(result))
    for problem in problems:
        print(f"outside its limit: {problem}", file=sys.stderr if options.json else sys.stdout)
    if out is not None:
        (out / "localisation-check.json").write_text(plain + "\n", encoding="utf-8")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
