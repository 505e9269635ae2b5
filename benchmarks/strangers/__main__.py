"""A fleet of strangers, flown: station keeping, tasks, and the tuning of the rival.

python -m benchmarks.strangers [--write]   hull x condition x task, and the rival; --write: docs/notes/strangers.md
python -m benchmarks.strangers hold        station keeping of all hulls and vehicles; see hold.py
python -m benchmarks.strangers tune        tune the rival again: gains.toml
"""

from __future__ import annotations

import argparse

from benchmarks.strangers import hold, page, tuning


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("hold", "tasks", "tune"), default="tasks")
    parser.add_argument("--quick", action="store_true", help="fewer rows, one start")
    parser.add_argument("--starts", type=int, default=3, help="of each row; of `hold`: the worst rows have 20")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--write", action="store_true", help=f"write {page.PAGE}")
    options = parser.parse_args()
    if options.what == "hold":
        print(hold.report(hold.run(quick=options.quick, starts=options.starts, jobs=options.jobs)))
    elif options.what == "tune":
        tuning.tune(options.jobs)
    else:
        starts = 1 if options.quick else options.starts
        text = page.text(page.run(starts=starts, jobs=options.jobs), starts)
        print(text)
        if options.write:
            page.PAGE.write_text(text)


if __name__ == "__main__":
    main()
