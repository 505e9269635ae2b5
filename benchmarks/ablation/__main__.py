"""Switch every optional mechanism off alone, on paired seeds, in runs with the event it exists for.

    .venv/bin/python -m benchmarks.ablation [--only PART ...] [--runs N] [--seed FIRST] [--out DIR]
                                            [--workers N] [--list] [--markdown]

For each measure the table has the mean (and the largest value) with and without the mechanism, the mean paired
difference "without - with" with its 95 % interval, and the smallest difference that this number of runs can detect
(2.8 standard errors of the paired difference). Results are kept in the folder, so that an interrupted study resumes.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.ablation.mechanism import Mechanism
from benchmarks.ablation.runner import MECHANISMS, Effect, effects, jobs, load, run, version
from services.tools.batch.results_store import open_store

HEADER = (
    "mechanism", "event", "runs", "measure", "with (worst)", "without (worst)", "difference (95 %)",
    "smallest detectable",
)  # fmt: skip


def rows(mechanism: Mechanism, found: list[Effect]) -> list[tuple[str, ...]]:
    """Return the lines of the table for one mechanism."""
    return [
        (
            mechanism.name if i == 0 else "",
            mechanism.event.description if i == 0 else "",
            str(e.pairs),
            e.measure,
            f"{e.with_it:.3g} ({e.worst_with:.3g})",
            f"{e.without:.3g} ({e.worst_without:.3g})",
            f"{e.difference:+.3g} ± {e.half_width:.2g}",
            f"{e.detectable:.2g}",
        )
        for i, e in enumerate(found)
    ]


def printed(table: list[tuple[str, ...]], *, markdown: bool) -> str:
    """Return the table as text, in columns or as Markdown."""
    if markdown:
        lines = [HEADER, tuple("---" for _ in HEADER), *table]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)
    wide = [max(len(line[i]) for line in [HEADER, *table]) for i in range(len(HEADER))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, wide, strict=True)) for line in [HEADER, *table])


def main() -> int:
    """Make the runs that are missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=[""], help="mechanisms whose name holds one of these")
    parser.add_argument("--runs", type=int, default=12, help="number of paired seeds")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--out", type=Path, default=Path("runs/ablation"), help="folder of the results")
    parser.add_argument("--workers", type=int, help="processes; as many as there are cores if not given")
    parser.add_argument("--list", action="store_true", help="list the mechanisms, run nothing")
    parser.add_argument("--markdown", action="store_true")
    options = parser.parse_args()
    chosen = [m for m in MECHANISMS if any(part in m.name for part in options.only)]
    if options.list:
        for m in chosen:
            print(f"{m.name}: {m.event.description}")
        return 0
    seeds = range(options.seed, options.seed + options.runs)
    with open_store(options.out, {"sources": version()}) as store:
        todo = jobs(chosen, seeds, set(load(store)))
        for done in run(todo, store, options.workers):
            print(f"\r{done} of {len(todo)}", end="", file=sys.stderr, flush=True)
        found = load(store)
    table = [row for m in chosen for row in rows(m, effects(m, seeds, found))]
    print(printed(table, markdown=options.markdown))
    return 0


if __name__ == "__main__":
    sys.exit(main())
