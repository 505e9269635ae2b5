"""A fleet of strangers, flown: station keeping and tasks.

python -m benchmarks.strangers [--write]   hull x condition x task, and the rival; --write: docs/notes/strangers.md
python -m benchmarks.strangers hold        station keeping of all hulls and vehicles; see hold.py
"""

from __future__ import annotations

import argparse

from benchmarks.strangers import hold, page


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("hold", "tasks"), default="tasks")
    parser.add_argument("--starts", type=int, default=3, help="of each row; of `hold`: the worst rows have 20")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--drawn", type=int, metavar="N", help="of `hold`: N hulls drawn at random; see drawn.py")
    parser.add_argument("--write", action="store_true", help=f"write {page.PAGE}")
    options = parser.parse_args()
    if options.what == "hold":
        rows = hold.drawn_rows(options.drawn) if options.drawn else hold.matrix()
        print(hold.report(hold.run(rows, starts=options.starts, workers=options.jobs)))
    else:
        text = page.text(page.run(starts=options.starts, workers=options.jobs), options.starts)
        print(text)
        if options.write:
            page.PAGE.write_text(text)


if __name__ == "__main__":
    main()
