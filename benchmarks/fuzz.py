"""Hostile frames at every decoder and file reader, a million by default: python -m benchmarks.fuzz [--json]

Each frame is a function of --seed, its reader's name and its number: --only NAME --first I --frames 1 sends it again.
Exit 1 where a reader crashed, let a wrong value in, or took memory without end.
"""

from __future__ import annotations

import argparse
import sys

import msgspec
from rich.console import Console
from rich.progress import Progress

from tests.fuzz import campaign
from tests.fuzz.targets import all_targets


def main() -> int:
    """Run the campaign and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=1_000_000, metavar="N", help="in all; default 1,000,000")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--only", default="", metavar="NAME", help="readers whose name contains this")
    parser.add_argument("--first", type=int, default=0, metavar="I", help="number of each reader's first frame")
    parser.add_argument("--json", action="store_true", help="the result alone, as JSON, on stdout")
    options = parser.parse_args()
    targets = [target for target in all_targets() if options.only in target.name]
    if not targets or options.frames < 1:
        parser.error("no frames: --frames N must be positive, and --only NAME part of a reader's name")
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task(f"{options.frames} frames at {len(targets)} readers", total=1.0)
        result = campaign.run(
            targets,
            options.frames,
            options.seed,
            first=options.first,
            told=lambda name, share: progress.update(task, completed=share, description=name),
        )
    print(msgspec.json.encode(result).decode() if options.json else text(result))
    return 0 if result.held else 1


def text(result: campaign.Result) -> str:
    """Format a line for each reader, then the invalid frames that were accepted."""
    lines = [f"{'reader':<24}{'frames':>9}{'accepted':>10}{'crashes':>9}{'let in':>8}{'slowest ms':>12}{'most MB':>9}"]
    for of in result.targets:
        counts = f"{of.frames:>9}{of.accepted:>10}{of.crashes:>9}{of.let_in:>8}"
        lines.append(f"{of.target:<24}{counts}{of.slowest_ms:>12.1f}{of.largest_bytes / 1e6:>9.1f}")
    lines += [f"{failure.target} {failure.index}: {failure.what}" for failure in result.failures]
    lines.append(
        f"{result.frames} frames, seed {result.seed}, {result.seconds:.0f} s: {result.crashes} crashes, "
        f"{result.let_in} wrong values let in, {result.beyond_memory} beyond {campaign.MOST_MEMORY >> 20} MiB for one "
        f"frame; the process grew by {result.grown_bytes / 1e6:.1f} MB"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
