"""Robustness table: cases of a wrong file and an unkind sea by laws.

python -m benchmarks.robustness [--cases TEXT ...] [--vehicles NAME ...] [--out DIR] [--write]

A case is KEY=VALUE pairs, "mass=1.3 drag=0.7"; cases.py has the keys. gains.toml has the gains of the
rivals. All vehicles and cases take hours: what is in DIR already is not flown again.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.robustness import flights, page
from benchmarks.robustness.cases import CASES, parsed
from benchmarks.robustness.laws import LAWS, tuned_gains
from benchmarks.strangers.flight import FOREIGN, SHIPPED


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", help="cases of your own or of the table, each in quotes")
    parser.add_argument(
        "--vehicles", nargs="+", choices=(*FOREIGN, *SHIPPED), help="default: two hulls and all shipped"
    )
    parser.add_argument("--tasks", nargs="+", choices=flights.TASK_NAMES, default=flights.TASK_NAMES)
    parser.add_argument("--starts", type=int, default=1, help="of each row")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep the flights; continue those that are there")
    parser.add_argument("--write", action="store_true", help=f"write {page.PAGE}")
    options = parser.parse_args()
    vehicles = options.vehicles or page.VEHICLES
    cases = options.cases or CASES
    try:
        for case in cases:
            parsed(case)
    except ValueError as error:
        parser.error(str(error))
    rows = [flights.Row(vehicle, task, case) for vehicle in vehicles for task in options.tasks for case in cases]
    with tempfile.TemporaryDirectory() as folder:
        out = options.out or Path(folder)
        found = flights.run(rows, LAWS, tuned_gains(), options.starts, options.jobs, out)
    print(f"{page.table(found)}\n\n{page.summary(found)}")
    if options.write:
        page.PAGE.write_text(page.text(found, options.starts))


if __name__ == "__main__":
    main()
