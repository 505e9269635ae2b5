"""Seed of the scenario ``demo``: the one of ordinary luck, the median of 100 by the distance of the vehicle.

    python -m benchmarks.demo_seed [--seeds 100] [--out runs/demo-seed]

All runs are in lock step. The campaign continues where it was interrupted.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pyarrow.parquet as pq

from services.cli.app import run

FIGURE = "true_error_m.mean"
SHARES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)


def main() -> int:
    """Run the campaign and print the distances by rank."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--out", type=Path, default=Path("runs/demo-seed"))
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    design = options.out.with_suffix(".toml")
    lines = ('title = "luck of the demo"', 'scenario = "demo"', f'minimise = "{FIGURE}"', "[seeds]")
    tables = (f"count = {options.seeds}", "[vary]", "run.surface_time_s = [30.0]")
    design.write_text("\n".join((*lines, *tables)) + "\n")
    if code := run(["campaign", str(design), "--out", str(options.out)]):
        return code
    rows = sorted(pq.read_table(options.out / "results.parquet").to_pylist(), key=lambda row: float(row[FIGURE]))
    for share in SHARES:
        row = rows[min(round(share * len(rows)), len(rows) - 1)]
        sys.stdout.write(f"{share:4.0%}  seed {row['seed']:3d}  {row[FIGURE]:.3f} m\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
