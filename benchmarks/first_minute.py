"""Wall time from a fresh clone to the live page: its address, and the first sample of the moving vehicle.

    .venv/bin/python -P -m benchmarks.first_minute [--commit COMMIT] [--installed]

The commit is cloned into a temporary folder, with an empty cache of compiled code, and ``make sim`` runs there. A
browser's part is played by a client of the page's stream: a browser draws a sample about a second after it has it.
``--installed`` uses this checkout's environment instead of installing one. The package manager's cache is used.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

HERE = Path(__file__).resolve().parent.parent
ADDRESS = "live page: "
PHASES = (("making .venv", "environment"), ("installing", "packages"), ("compiling", "compiling begins"))
"""Start of a line of the output, and what has begun."""

PATIENCE_S = 900.0


def texts(url: str, until_s: float) -> Iterator[dict[str, Any]]:
    """Yield the texts of the page's stream. The page may give way to the run's start, so connect again if it ends."""
    while time.monotonic() < until_s:
        try:
            with connect(f"ws://{urlsplit(url).netloc}/stream", origin=f"http://{urlsplit(url).netloc}") as stream:
                for text in stream:
                    yield json.loads(text)
        except (OSError, WebSocketException):
            time.sleep(0.2)


def wait_for_motion(url: str, until_s: float) -> bool:
    """Return True as soon as the stream shows a vehicle that sinks while the clock runs."""
    for text in texts(url, until_s):
        status = text["status"]
        if status["clock"] == "running" and (status["progress"] or 0.0) > 0.0 and status["depth_m"]:
            return True
    return False


def main() -> None:
    """Print the time of each step as it is reached."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commit", default="HEAD")
    parser.add_argument("--installed", action="store_true", help="use this checkout's environment")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="ltv-mpc-first-", ignore_cleanup_errors=True) as temporary:
        clone, started_s = Path(temporary) / "clone", time.monotonic()

        def reached(what: str) -> None:
            print(f"{time.monotonic() - started_s:6.1f} s  {what}", flush=True)

        subprocess.run(("git", "clone", "-q", str(HERE), str(clone)), check=True)
        subprocess.run(("git", "checkout", "-q", options.commit), cwd=clone, check=True)
        command: tuple[str, ...] = ("make", "sim")
        if options.installed:
            command = (sys.executable, "-P", "-m", "services.cli", "sim", "--dashboard")
        environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
        environment["XDG_CACHE_HOME"], environment["PYTHONPATH"] = temporary, str(clone)
        environment |= {"UV_CACHE_DIR": os.environ.get("UV_CACHE_DIR", str(Path.home() / ".cache" / "uv"))}
        process = subprocess.Popen(
            command, cwd=clone, env=environment, text=True, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            assert process.stdout is not None
            waiting = dict(PHASES)
            for line in process.stdout:
                for start in [start for start in waiting if line.startswith(start)]:
                    reached(waiting.pop(start))
                if ADDRESS in line:
                    reached("address of the page")
                    moving = wait_for_motion(line.partition(ADDRESS)[2].strip(), time.monotonic() + PATIENCE_S)
                    reached("first sample of the moving vehicle" if moving else "no sample")
                    break
        finally:
            os.killpg(process.pid, signal.SIGINT)
            process.communicate()


if __name__ == "__main__":
    main()
