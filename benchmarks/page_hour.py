"""Processor time and memory of the live page and of a browser that shows it, over a long run.

    .venv/bin/python -m benchmarks.page_hour [--minutes 60] [--every-s 30] [--speed 1]

`hover` by `ltv-mpc sim`, with one headless browser that draws all the time. Shares are percent of a core. Memory is
what the processes have written (Pss_Anon); the heap is that of the page's scripts, after a collection of garbage.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from playwright.sync_api import sync_playwright

from benchmarks.dashboard_cost import SAYS
from benchmarks.processor_time import read_times
from benchmarks.soak import look
from tests.browser.conftest import SCREEN, executable

PARTS = 6


class Sample(NamedTuple):
    """Processor time (s) and memory (MB) since the start of the page's process, of the browser, and of its scripts."""

    at_s: float
    page_cpu_s: float
    page_mb: float
    browser_cpu_s: float
    browser_mb: float
    heap_mb: float


def sample(began_s: float, supervisor: int, client: Any) -> Sample:
    """Return what page and browser have used until now."""
    client.send("HeapProfiler.collectGarbage")
    metrics = {one["name"]: one["value"] for one in client.send("Performance.getMetrics")["metrics"]}
    page = {pid: row for pid, row in read_times(supervisor).items() if row[0] == "dashboard"}
    browser = {
        pid: row for pid, row in read_times(os.getpid()).items() if row[0].startswith(("chrom", "google-chrome"))
    }
    at_s = time.monotonic() - began_s
    used = [(sum(row[1] + row[2] for row in of.values()), memory_mb(of)) for of in (page, browser)]
    return Sample(at_s, *used[0], *used[1], metrics["JSHeapUsedSize"] / 2**20)


def memory_mb(pids: Any) -> float:
    """Return the written memory of all these processes."""
    return sum(seen.memory_mb for pid in pids if (seen := look(pid, 0.0)) is not None)


def samples(out: Path, wall_s: float, every_s: float, speed: float) -> list[Sample]:
    """Run the vehicle, the page and a browser, and sample them."""
    options = ["--duration-s", f"{2 * speed * wall_s:g}", "--speed", f"{speed:g}", "--dashboard", "--out", str(out)]
    command = [sys.executable, "-P", "-m", "services.cli", "sim", "hover", *options]
    with (
        sync_playwright() as play,
        play.chromium.launch(executable_path=executable(), args=["--no-sandbox"]) as browser,
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process,
    ):
        assert process.stderr is not None
        url = next(line.removeprefix(SAYS).strip() for line in process.stderr if line.startswith(SAYS))
        tab = browser.new_page(viewport={"width": SCREEN[0], "height": SCREEN[1]})
        tab.goto(url)
        client = tab.context.new_cdp_session(tab)
        client.send("Performance.enable")
        began_s, found = time.monotonic(), []
        while process.poll() is None and time.monotonic() < began_s + wall_s:
            found.append(sample(began_s, process.pid, client))
            print(found[-1], file=sys.stderr, flush=True)
            tab.wait_for_timeout(1e3 * every_s)
        print(" ".join(tab.inner_text("#figures").split()), file=sys.stderr)
        process.send_signal(signal.SIGINT)
        process.communicate()
    return found


def main() -> None:
    """Run, and print a table with one row for each part of the time."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of wall time")
    parser.add_argument("--every-s", type=float, default=30.0)
    parser.add_argument("--speed", type=float, default=1.0)
    of = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        found = samples(Path(place, "run"), 60.0 * of.minutes, of.every_s, of.speed)
    print("| minutes | page (% of a core) | page (MB) | browser (% of a core) | browser (MB) | heap (MB) |")
    print("|---|---:|---:|---:|---:|---:|")
    for part in np.array_split(np.array(found), PARTS):
        at_s, page_s, page_mb, browser_s, browser_mb, heap_mb = part.T
        over_s = (at_s[-1] - at_s[0]) / 100
        shares = [f"{(used[-1] - used[0]) / over_s:.1f}" for used in (page_s, browser_s)]
        memory = [f"{np.median(mb):.1f}" for mb in (page_mb, browser_mb, heap_mb)]
        cells = (f"{at_s[0] / 60:.0f} to {at_s[-1] / 60:.0f}", shares[0], memory[0], shares[1], *memory[1:])
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
