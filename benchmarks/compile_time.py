"""Processor time of compiling what a run needs, by file and by function, with an empty cache.

    .venv/bin/python -P -m benchmarks.compile_time [--against CHECKOUT] [--turns N] [--functions N]

The parts of ``services.supervisor.jit_cache`` are compiled one after another, each by a process of its own; they share
one cache folder, as in a run. A second checkout is measured interleaved with this one, with the same interpreter.

The time of a function includes the functions of numba that are compiled for it, and not the project's functions that
it calls. It does include the optimisation of their machine code, which is inlined.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from rich.console import Console
from rich.table import Table

from services.supervisor.jit_cache import PARTS

HERE = Path(__file__).resolve().parent.parent
SCENARIO = "descent"

MEASURE = """
import gc, json, os, sys, time
started_s = time.process_time()
import numba
from numba.core import event
rows, stack = {}, []
root = os.getcwd() + os.sep
parts = tuple(root + folder for folder in ("ltv_mpc", "sim"))

class Own(event.Listener):
    def on_start(self, e):
        function = e.data["dispatcher"].py_func
        file = function.__code__.co_filename
        name = file.removeprefix(root) + " " + function.__qualname__ if file.startswith(parts) else None
        stack.append([name, time.process_time(), 0.0])

    def on_end(self, e):
        now_s = time.process_time()
        name, start_s, inside_s = stack.pop()
        owner = name or next((x[0] for x in reversed(stack) if x[0]), "numba")
        row = rows.setdefault(owner, [0.0, 0, 0])
        row[0] += now_s - start_s - inside_s
        row[1 if name else 2] += 1
        if stack:
            stack[-1][2] += now_s - start_s

event.register("numba:compile", Own())
gc.disable()
from services.supervisor import jit_cache
jit_cache.warm_up(jit_cache.resolve(sys.argv[2]), sys.argv[1])
print(json.dumps({"total_s": time.process_time() - started_s, "rows": rows}))
"""
"""Program that compiles one part and prints for each function: seconds, specialisations, functions of numba."""

Parts: TypeAlias = dict[str, dict[str, Any]]
"""Result of ``MEASURE`` for each part."""


def measure(checkout: Path) -> Parts:
    """Compile all parts into an empty folder, in their order: what the controller shares is compiled before."""
    results = {}
    with tempfile.TemporaryDirectory(prefix="ltv-mpc-compile-") as cache:
        for part in PARTS:
            process = subprocess.run(
                (sys.executable, "-P", "-c", MEASURE, part, SCENARIO),
                cwd=checkout,
                env={**os.environ, "PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": cache},
                stdout=subprocess.PIPE,
                text=True,
                check=True,
            )
            results[part] = json.loads(process.stdout.splitlines()[-1])
    return results


def total_s(parts: Parts) -> float:
    """Return the processor time of all parts (s)."""
    return float(sum(part["total_s"] for part in parts.values()))


def summary(parts: Parts) -> str:
    """Return the processor time of all parts and of each."""
    of_each = ", ".join(f"{name} {part['total_s']:.1f}" for name, part in parts.items())
    return f"{total_s(parts):.1f} s ({of_each})"


def table(title: str, rows: Iterable[tuple[str, tuple[float, int, int]]], most: int) -> Table:
    """Return the rows that take longest, and their sum."""
    sums: defaultdict[str, np.ndarray] = defaultdict(lambda: np.zeros(3))
    for name, row in rows:
        sums[name] += row
    result = Table(title, "specialisations", "of numba", "s")
    ordered = sorted(sums.items(), key=lambda item: -item[1][0])
    for name, (spent_s, count, own) in [*ordered[:most], (f"all {len(sums)}", sum(sums.values()))]:
        result.add_row(name, f"{count:.0f}", f"{own:.0f}", f"{spent_s:.2f}")
    return result


def main() -> None:
    """Measure, and print the tables of the last turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="another checkout, measured interleaved")
    parser.add_argument("--turns", type=int, default=1)
    parser.add_argument("--functions", type=int, default=40, help="how many functions to list")
    options = parser.parse_args()
    ratios, console = [], Console(width=120)
    for _ in range(options.turns):
        parts = measure(HERE)
        console.print(f"processor time {summary(parts)}")
        if options.against:
            before = measure(options.against.resolve())
            ratios.append(total_s(parts) / total_s(before))
            console.print(f"before         {summary(before)}: ratio {ratios[-1]:.3f}")
    rows = [item for part in parts.values() for item in part["rows"].items()]
    console.print(table("file", ((name.split()[0], row) for name, row in rows), len(rows)))
    console.print(table("function", rows, options.functions))
    if ratios:
        console.print(f"median ratio of {len(ratios)} turns: {np.median(ratios):.3f}")


if __name__ == "__main__":
    main()
