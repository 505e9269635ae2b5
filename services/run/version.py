"""Which version of this project runs: one text for `ltv-mpc --version`, a run's files and the doctor.

A wheel knows the version that the git tag gave it when it was built. A checkout that is installed editable was told
one at the day of its installation, while its code goes on: of that the release alone still holds, and the commit that
is checked out now stands behind it.
"""

from __future__ import annotations

import re
import subprocess
from importlib import metadata
from pathlib import Path

DISTRIBUTION = "auv-ltv-mpc"
ROOT = Path(__file__).resolve().parents[2]

UNKNOWN = "unknown"


def version() -> str:
    """As installed, ``0.2.0``; of a checkout ``0.2.0+g1a2b3c4d5``, with ``.changed`` where files differ from that."""
    return of(installed(), commit())


def installed() -> str:
    """The version that the distribution was installed as."""
    try:
        return metadata.version(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        return UNKNOWN


def of(installed: str, commit: str) -> str:
    """What a distribution's version and the commit that is checked out, if any, come to."""
    if UNKNOWN in (commit, installed):
        return installed
    release = re.sub(r"(?<=\.dev)\d+", "", installed.partition("+")[0])
    name, _, changes = commit.partition(" ")
    return f"{release}+g{name[:9]}{'.changed' if changes else ''}"


def commit() -> str:
    """The commit that is checked out, ``and changes`` where files differ from it; "unknown" outside a checkout."""
    if not (ROOT / ".git").exists():
        return UNKNOWN
    try:
        head, changed = (_git(*words) for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "-uno")))
    except (OSError, subprocess.SubprocessError):
        return UNKNOWN
    return head + (" and changes" if changed else "")


def _git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, timeout=5, check=True)
    return done.stdout.strip()
