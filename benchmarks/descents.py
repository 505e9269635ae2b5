"""Table of errors of the README: the paper's descent, many seeds, every setting with the same currents.

    .venv/bin/python -m benchmarks.descents [--seeds N]

Each row is the mean over seeds 0 to N-1 (20) of one setting, in lock step: figures repeat on one machine.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable, Sequence

from benchmarks.batch import Job, in_order
from sim.evaluation.summary import Summary

KNOWN = ("run.perfect_state=true",)
PAPER_COST = (
    "controller.weights.terminal_position_per_m2=0.0",
    "controller.weights.terminal_velocity_s2_per_m2=0.0",
)
HIGH = ("controller.effort=high",)
SHORT, PAPER, LONG = (
    (f"controller.horizon_s={horizon_s}", *HIGH) for horizon_s in (2.5, 5.0, 10.0)
)  # the paper's horizons, and twice the longer one
ONE = ("controller.sqp_iterations=1",)
FIXES = ("run.surface_time_s=30.0",)
REALISTIC = ('sensors="realistic"', *FIXES)

ROWS = {
    "no control": (*KNOWN, "controller.lateral=false"),
    "known state, 2.5 s": (*KNOWN, *SHORT),
    "known state, default": KNOWN,
    "known state, 5 s": (*KNOWN, *PAPER),
    "known state, 5 s, one QP a cycle": (*KNOWN, *PAPER, *ONE),
    "known state, 5 s, 0.71 s of computing": (*KNOWN, *PAPER, "run.compute_delay_s=0.71"),
    "known state, 10 s": (*KNOWN, *LONG),
    "known state, the paper's cost, 2.5 s": (*KNOWN, *PAPER_COST, *SHORT),
    "known state, the paper's cost, 5 s": (*KNOWN, *PAPER_COST, *PAPER),
    "full loop, paper sensors, 1 TDCP fix, default": (),
    "full loop, realistic sensors, 30 TDCP fixes, default": REALISTIC,
    "full loop, paper sensors, 1 TDCP fix": PAPER,
    "full loop, paper sensors, 30 TDCP fixes": (*FIXES, *PAPER),
    "full loop, paper sensors, 30 TDCP fixes, one QP a cycle": (*FIXES, *PAPER, *ONE),
    "full loop, realistic sensors, 30 TDCP fixes": (*REALISTIC, *PAPER),
    "full loop, realistic sensors, 30 TDCP fixes, one QP a cycle": (*REALISTIC, *PAPER, *ONE),
}

COLUMNS: dict[str, Callable[[Summary], float | None]] = {
    "tracking (m)": lambda s: s.tracking_error_m.mean,
    "localisation (m)": lambda s: s.localisation_error_m.mean,
    "true error (m)": lambda s: s.true_error_m.mean,
    "mean abs F (N)": lambda s: s.thrust.mean_abs_N,
    "saturated (%)": lambda s: None if s.thrust.saturated_fraction is None else 100 * s.thrust.saturated_fraction,
}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args()
    jobs = [Job("descent", (f"run.seed={seed}", *row)) for row in ROWS.values() for seed in range(options.seeds)]
    everyone = in_order(Job.summary, jobs)
    summaries = {name: everyone[i * options.seeds : (i + 1) * options.seeds] for i, name in enumerate(ROWS)}
    table = {
        name: {column: statistics.fmean(figures(of, rows)) for column, of in COLUMNS.items()}
        for name, rows in summaries.items()
    }
    print(f"| mean of {options.seeds} seeds | " + " | ".join(COLUMNS) + " |")
    print("|---|" + "---|" * len(COLUMNS))
    for name, row in table.items():
        print(f"| {name} | " + " | ".join(text(value) for value in row.values()) + " |")


def figures(of: Callable[[Summary], float | None], rows: Sequence[Summary]) -> list[float]:
    """One figure of each run that has it."""
    return [value for value in map(of, rows) if value is not None]


def text(value: float) -> str:
    """Three figures that count."""
    return f"{value:.3f}" if value < 10 else f"{value:.1f}"


if __name__ == "__main__":
    main()
