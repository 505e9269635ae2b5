"""Cost of the live page for the controller: cycle times with the page and three readers, and without.

    .venv/bin/python -m benchmarks.dashboard_cost [--pairs N] [--duration-s T] [--speed X]

Pairs of runs, one after the other and in alternating order; the readers draw nothing. A figure is pooled over all
pairs; its interval (95 %) is bootstrapped by pairs, because cycles of one run are not independent. A limit holds if the
interval's lower end is below it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from ltv_mpc.messages import Array, CycleTiming
from services.recording.reader import Recording

READERS = 3
RESAMPLED = 4000
LIMITS = {50: 5.0, 99: 25.0}  # percentile of the cycle -> percent
SAYS = "live page: "


def read(url: str, counts: list[int]) -> None:
    """Take everything, look at nothing, until the page goes."""
    origin = url.partition("/#")[0]
    taken = 0
    try:
        with connect(f"{origin.replace('http', 'ws', 1)}/stream", origin=origin, proxy=None, max_size=None) as socket:  # type: ignore[arg-type]
            for _ in socket:
                taken += 1
    except (WebSocketException, OSError):
        pass
    counts.append(taken)


def cycles_ms(out: Path, *, page: bool, duration_s: float, speed: float) -> tuple[Array, int]:
    """Wall time of each cycle of one run after t = 0 (ms), and how many texts its readers took."""
    options = ["--duration-s", f"{duration_s:g}", "--speed", f"{speed:g}", "--surface-time-s", "1", "--out", str(out)]
    command = [sys.executable, "-P", "-m", "services.cli", "sim", *options, "--dashboard" if page else "--no-dashboard"]
    counts: list[int] = []
    lines: list[str] = []
    readers: list[threading.Thread] = []
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            lines.append(line)
            if line.startswith(SAYS):
                url = line.removeprefix(SAYS).strip()
                readers = [threading.Thread(target=read, args=(url, counts)) for _ in range(READERS)]
                for reader in readers:
                    reader.start()
    for reader in readers:
        reader.join()
    if process.returncode != 0 or (page and len(readers) != READERS):
        sys.exit(f"{' '.join(command)}: exit code {process.returncode}, {len(readers)} readers\n{''.join(lines[-5:])}")
    timings = (message for message in Recording(out / "run.mcap") if message.kind is CycleTiming)
    wall_ns = [message.plain["compute_wall_ns"] for message in timings if message.plain["t_ns"] >= 0]
    return np.array(wall_ns) / 1e6, sum(counts)


def change_percent(with_page: list[Array], without: list[Array], percentile: int) -> float:
    """Return the change of this percentile of the pooled cycle times (%)."""
    a, b = (np.percentile(np.concatenate(runs), percentile) for runs in (with_page, without))
    return float(100 * (a / b - 1))


def interval(with_page: list[Array], without: list[Array], percentile: int) -> tuple[float, float]:
    """Return the 95 % interval of the change, by pairs of runs."""
    rng = np.random.default_rng(0)
    pairs = len(without)
    drawn = []
    for _ in range(RESAMPLED):
        chosen = rng.integers(pairs, size=pairs)
        drawn.append(change_percent([with_page[i] for i in chosen], [without[i] for i in chosen], percentile))
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)


def main(pairs: int, duration_s: float, speed: float) -> None:
    """Run, and print a table."""
    with_page: list[Array] = []
    without: list[Array] = []
    texts = 0
    with tempfile.TemporaryDirectory() as folder:
        for k in range(pairs):
            for page in (False, True) if k % 2 == 0 else (True, False):
                ms, taken = cycles_ms(Path(folder) / f"{k}-{page}", page=page, duration_s=duration_s, speed=speed)
                (with_page if page else without).append(ms)
                texts += taken
            print(f"pair {k + 1} of {pairs}", file=sys.stderr)
    print(f"{pairs} pairs of {duration_s:g} s at {speed:g} x real time, {READERS} readers, {texts} texts\n")
    print("| cycle | without (ms) | with (ms) | change (%) | 95 % | limit (%) | holds |\n|---|---|---|---|---|---|---|")
    for percentile, limit in LIMITS.items():
        a, b = (float(np.percentile(np.concatenate(runs), percentile)) for runs in (without, with_page))
        low, high = interval(with_page, without, percentile)
        change = change_percent(with_page, without, percentile)
        name = "median" if percentile == 50 else f"p{percentile}"
        verdict = "yes" if low < limit else "no"
        print(f"| {name} | {a:.3f} | {b:.3f} | {change:+.1f} | {low:+.1f} to {high:+.1f} | {limit:g} | {verdict} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The live page's cost to the controller.")
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--duration-s", type=float, default=200.0)
    parser.add_argument("--speed", type=float, default=10.0)
    given = parser.parse_args()
    main(given.pairs, given.duration_s, given.speed)
