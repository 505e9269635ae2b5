"""Table of the foreign craft's scenarios: ``python -m tests.foreign_plant [NAME ...]``; exit code 1 beyond a limit."""

from __future__ import annotations

import sys

from tests.foreign_plant import scenarios


def main(names: list[str]) -> int:
    """Run the scenarios, all if none is named, and print their figures. Return the exit code."""
    unknown = sorted(set(names) - set(scenarios.NAMES))
    if unknown:
        sys.stderr.write(f"no scenario named {', '.join(unknown)}; there are: {', '.join(scenarios.NAMES)}\n")
        return 2
    beyond = 0
    for name in names or scenarios.NAMES:
        for figure in scenarios.run(name):
            within = figure.value <= figure.limit
            beyond += not within
            mark = "" if within else "  beyond the limit"
            sys.stdout.write(
                f"{name:20} {figure.name:48} {figure.value:9.3f} <= {figure.limit:g} {figure.unit}{mark}\n"
            )
            sys.stdout.flush()
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
