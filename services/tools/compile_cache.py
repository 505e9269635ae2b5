"""Fill the cache of compiled code with a progress bar: ``python -m services.tools.compile_cache SCENARIO``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from services.reporting.terminal import progress_bar
from services.supervisor import jit_cache


def main() -> int:
    """Compile what a run of the named scenario needs; return the exit code of the process that does it."""
    with progress_bar("compiling, once") as told:

        def wait(share: float) -> None:
            told(share)
            time.sleep(jit_cache.POLL_S)

        return jit_cache.fill(Path(sys.argv[1]), None, wait)


if __name__ == "__main__":
    sys.exit(main())
