"""Hostile frames at every decoder and file reader, a million by default: python -m benchmarks.fuzz [--json]

Each frame is a function of --seed, its reader's name and its number: --only NAME --first I --frames 1 sends it again.
Exit 1 where a reader crashed, let a wrong value in, or took memory without end.
"""

from __future__ import annotations

import argparse
import sys

import msgspec
from rich.console import Console
from rich.progress import track

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
    each = list(zip(targets, campaign.shares(targets, options.frames), strict=True))
    accounts = [
        campaign.attack(target, frames, options.seed, first=options.first)
        for target, frames in track(each, f"{options.frames} frames", console=Console(stderr=True))
    ]
    if options.json:
        print(msgspec.json.encode(accounts).decode())
    else:
        print(f"{'reader':<24}{'frames':>9}{'accepted':>10}{'failed':>9}{'slowest ms':>12}{'most MB':>9}")
        for of in accounts:
            counts = f"{of.frames:>9}{of.accepted:>10}{of.failed:>9}"
            print(f"{of.target:<24}{counts}{of.slowest_ms:>12.1f}{of.largest_bytes / 1e6:>9.1f}")
        print(*(failure for of in accounts for failure in of.failures), sep="\n", end="")
    return int(any(of.failed for of in accounts))


if __name__ == "__main__":
    sys.exit(main())
