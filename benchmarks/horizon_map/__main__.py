"""Figure and numbers of docs/horizon.md, from the two campaigns that ``make map`` runs.

    .venv/bin/python -m benchmarks.horizon_map --known DIR --realistic DIR [--page docs/horizon.md]

Beside the page: horizon.json, which holds its numbers, and figures/horizon.png.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks.horizon_map import picture
from benchmarks.horizon_map.places import places
from benchmarks.horizon_map.rules import FOLDS
from benchmarks.horizon_map.summary import summary, tables
from benchmarks.page_tables import replace_tables


def main() -> None:
    """Read, fit, draw, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--known", type=Path, required=True)
    parser.add_argument("--realistic", type=Path, required=True)
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    maps = {"state known": places(options.known), "realistic": places(options.realistic)}
    for name, of in maps.items():
        if len(of) < 2 * FOLDS:
            parser.error(f"{name}: {len(of)} places were flown whole, {2 * FOLDS} are needed")
    kept = {name: summary(of) for name, of in maps.items()}
    text = json.dumps(kept, indent=1)
    print(text)
    if options.page is not None:
        options.page.with_suffix(".json").write_text(text + "\n", encoding="utf-8")
        page = replace_tables(options.page.read_text(encoding="utf-8"), tables(kept))
        options.page.write_text(page, encoding="utf-8")
        picture.draw(kept, options.page.parent / "figures" / "horizon.png")


if __name__ == "__main__":
    main()
