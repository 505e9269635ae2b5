"""Version of the running code: one text for `ltv-mpc --version`, a run's files and the doctor.

A wheel has the version of its git tag. An editable checkout has the version of the day of its installation, while its
code changes: of that version only the release is still valid, and the commit that is checked out now is appended.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import ltv_mpc

ROOT = Path(__file__).resolve().parents[2]

UNKNOWN = "unknown"


def version() -> str:
    """Return the version: ``0.2.0``, for a checkout ``0.2.0+g1a2b3c4d5``, and ``.changed`` if its files differ."""
    return combine(installed(), commit())


def installed() -> str:
    """Return the version of the installed distribution."""
    return ltv_mpc.__version__


def combine(installed: str, commit: str) -> str:
    """Combine a distribution's version with the commit that is checked out, if there is one."""
    if UNKNOWN in (commit, installed):
        return installed
    release = re.sub(r"(?<=\.dev)\d+", "", installed.partition("+")[0])
    name, _, changes = commit.partition(" ")
    return f"{release}+g{name[:9]}{'.changed' if changes else ''}"


def commit() -> str:
    """Return the commit, with ``and changes`` if files differ from it; "unknown" outside a checkout."""
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
