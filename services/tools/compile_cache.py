"""Fill the cache of compiled code with a progress bar: ``python -m services.tools.compile_cache SCENARIO``."""

from __future__ import annotations

import subprocess
import sys
import time

from services.reporting.terminal import progress_bar
from services.supervisor import jit_cache


def main() -> int:
    """Compile what a run of the named scenario needs; return the exit code of the process that does it."""
    before = jit_cache.stored_bytes()
    process = subprocess.Popen(jit_cache.command(sys.argv[1]), stdin=subprocess.DEVNULL)
    try:
        with progress_bar("compiling, once") as told:
            while process.poll() is None:
                told(jit_cache.share(before))
                time.sleep(jit_cache.POLL_S)
    finally:
        process.kill()
        process.wait()
    return process.returncode


if __name__ == "__main__":
    sys.exit(main())
