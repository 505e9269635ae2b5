"""Wall time from a fresh clone to the live page: its address, and the first sample of the moving vehicle.

    .venv/bin/python -P -m benchmarks.first_minute [--commit COMMIT] [--installed]

The commit is cloned into a temporary folder, with an empty cache of compiled code, and ``make sim`` runs there. A
browser's part is played by a client of the page's stream: a browser draws a sample a tenth of a second after it has it.
``--installed`` uses this checkout's environment instead of installing one. The package manager's cache is used.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from websockets.sync.client import connect

HERE = Path(__file__).resolve().parent.parent
ADDRESS = "live page: "
PHASES = (("making .venv", "environment"), ("installing", "packages"), ("compiling", "compiling begins"))
"""Start of a line of the output, and what has begun."""


def statuses(url: str) -> Iterator[dict[str, Any]]:
    """Open the page, report that it is drawn, and yield each status of its stream."""
    address = urlsplit(url).netloc
    urllib.request.urlopen(f"http://{address}/").close()
    with connect(f"ws://{address}/stream", origin=f"http://{address}", proxy=None, max_size=2**24) as stream:
        stream.send(json.dumps({"number": 0, "token": "", "button": "drawn"}))
        yield from (text["status"] for text in map(json.loads, stream) if "status" in text)


def watch(url: str, reached: Callable[[str], None]) -> None:
    """Report the first status, each tenth of the preparation, and the first sample of a vehicle that sinks."""
    preparation, shown = "", ""
    for status in statuses(url):
        preparation = status["preparation"] if status["clock"] == "silent" else ""
        if preparation and (step := re.sub(r"\d% after \d+ s", "0 %", preparation)) != shown:
            shown = step
            reached(f"page: {preparation}")
        if status["clock"] == "running" and (status["t_s"] or 0.0) > 0.0 and (status["depth_m"] or 0.0) > 0.0:
            reached(f"first sample of the moving vehicle, {status['t_s']:.1f} s after the start of the descent")
            return


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
                    watch(line.partition(ADDRESS)[2].strip(), reached)
                    break
        finally:
            os.killpg(process.pid, signal.SIGINT)
            process.communicate()


if __name__ == "__main__":
    main()
