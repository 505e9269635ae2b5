"""Prepare a release: ``release.py check VERSION`` before the checks, ``release.py tag VERSION`` after them.

Nothing is uploaded and nothing is pushed. The version is that of the tag (hatch-vcs).
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CHANGELOG = ROOT / "CHANGELOG.md"


def check(version: str) -> str | None:
    """Return what keeps this version from being released, or None."""
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        return f"{version!r} is no version: set VERSION=0.1.0, for example"
    if _git("status", "--porcelain"):
        return "the checkout has changes that are not committed: commit them"
    if _git("tag", "--list", f"v{version}"):
        return f"the tag v{version} exists: set VERSION to the next version"
    heading = re.search(r"^## (.*)$", CHANGELOG.read_text(encoding="utf-8"), re.MULTILINE)
    if heading is None or not re.fullmatch(rf"{re.escape(version)}, \d{{4}}-\d\d-\d\d", heading[1]):
        found = "none" if heading is None else heading[1]
        return f"the first heading of CHANGELOG.md is {found!r}: write '## {version}, YYYY-MM-DD' and commit it"
    return None


def tag(version: str) -> str | None:
    """Tag the commit, or return what keeps it from being tagged."""
    wheels = sorted(path.name for path in (ROOT / "dist").glob("*.whl"))
    if not any(f"-{version}-" in name for name in wheels):
        return f"dist/ has no wheel of {version}: {', '.join(wheels) or 'it is empty'}"
    _git("tag", "--annotate", f"v{version}", "--message", f"Version {version}")
    print(f"tagged v{version}; dist/ holds {', '.join(wheels)}. To publish: git push origin v{version}")
    return None


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    what, version = sys.argv[1:] if len(sys.argv) == 3 else ("check", "")
    sys.exit({"check": check, "tag": tag}[what](version))
