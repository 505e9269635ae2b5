"""Resources that a run needs are checked before anything is made."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

from services.run.host_resources import MIN_OPEN_FILES, check_open_files


def test_a_hard_limit_of_24_open_files_is_named_with_what_raises_it(tmp_path: Path) -> None:
    words = [sys.executable, "-P", "-m", "services.cli", "sim", "--out", str(tmp_path / "run")]
    limited = ["sh", "-c", 'ulimit -n 24; exec "$@"', "sh", *words]
    ended = subprocess.run(limited, capture_output=True, text=True, check=False, timeout=60)
    assert ended.returncode == 1
    assert ended.stderr.startswith("ltv-mpc: the limit on open files is 24 (`ulimit -n`), a run needs 64: raise it")
    assert ended.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_soft_limit_is_raised() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (MIN_OPEN_FILES - 1, hard))
    try:
        check_open_files()
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (MIN_OPEN_FILES, hard)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
