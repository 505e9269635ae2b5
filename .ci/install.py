"""Install the project with some of its extras into the environment of the Python that runs this.

uv does in seconds what takes pip a minute or two, half of it for bytecode that is never read: Python keeps that of a
module when it is first imported. Where it is told not to (PYTHONDONTWRITEBYTECODE), every process would compile its
thousand modules again, two seconds each time; there all bytecode is made with the installation. uv is told of the same
sources: pip's settings (index, further indexes, folders, certificates) are handed on.

requirements.lock has the versions and the hashes of all files of the packages, and ``install.py --lock`` makes it. A
file with another hash is not installed, so it does not matter which source has it. Where no source has a version of the
lock, the newest that pyproject.toml allows are taken, each package from the first source that has it. Where uv cannot
be had, or does not manage, pip does it. Their output is in .venv/install.log; a terminal shows one line, with the
seconds and the number of packages so far.
"""

from __future__ import annotations

import ast
import contextlib
import os
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

LOCK = "requirements.lock"
LOG = Path(os.path.relpath(sys.prefix)) / "install.log"
SITE = Path(sysconfig.get_path("purelib"))
ERASE = "\r\x1b[2K"
LOOK_S = 0.5
SHOWN_LINES = 20
"""Last lines of the log that a failure prints."""

HANDED_ON = {
    "index-url": "UV_DEFAULT_INDEX",
    "extra-index-url": "UV_INDEX",
    "find-links": "UV_FIND_LINKS",
    "no-index": "UV_NO_INDEX",
    "cert": "SSL_CERT_FILE",
    "proxy": "ALL_PROXY",
    "trusted-host": "UV_INSECURE_HOST",
}
"""pip's settings, and what uv calls them."""

SECTIONS = ("global", "install", ":env:")
"""Where pip's settings stand: the last one that has a setting wins."""

LISTS_WITH_COMMAS = {"find-links"}
"""pip separates what these name by spaces, uv by commas."""

WRONG_HASH = b"Hash mismatch"
"""Words of uv for a file whose hash is not in the lock."""

PIP = (sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
UV = (sys.executable, "-m", "uv", "pip")


def sources(settings: str) -> dict[str, str]:
    """Return the output of ``pip config list`` (one ``section.name='value'`` a line) as variables for uv."""
    found: dict[tuple[str, str], str] = {}
    for line in settings.splitlines():
        key, _, value = line.partition("=")
        section, _, name = key.rpartition(".")
        if name in HANDED_ON and section in SECTIONS:
            found[section, name] = str(ast.literal_eval(value))
    given: dict[str, str] = {}
    for section in SECTIONS:
        for name, variable in HANDED_ON.items():
            if (section, name) in found:
                words = found[section, name].split()
                given[variable] = (",".join if name in LISTS_WITH_COMMAS else " ".join)(words)
    return given


def environment() -> dict[str, str]:
    """Return the environment of uv."""
    listing = [sys.executable, "-m", "pip", "config", "list"]
    settings = subprocess.run(listing, capture_output=True, text=True, check=False).stdout
    return {**sources(settings), **os.environ}


def lock() -> int:
    """Write ``LOCK``: the newest versions for every Python and system, with hashes, from the default index alone."""
    env = {name: value for name, value in environment().items() if name not in ("UV_INDEX", "UV_FIND_LINKS")}
    options = (
        "--all-extras",
        "--universal",
        "--python-version",
        "3.11",
        "--generate-hashes",
        "--upgrade",
        "--no-header",
    )
    quiet = ("--quiet", "--no-annotate", "--no-emit-index-url", "--no-emit-find-links")
    return subprocess.run(
        [*UV, "compile", "pyproject.toml", *options, *quiet, "-o", LOCK], env=env, check=False
    ).returncode


def logged(command: Sequence[str], *, env: Mapping[str, str] | None = None) -> int:
    """Run a command with its output in ``LOG``, and return its exit code. On a terminal a line shows how far it is."""
    began_s = time.monotonic()
    with LOG.open("ab") as log, subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=env) as process:
        while process.poll() is None:
            if sys.stderr.isatty():
                packages = sum(1 for _ in SITE.glob("*.dist-info"))
                sys.stderr.write(
                    f"{ERASE}installing into .venv  {time.monotonic() - began_s:.0f} s, {packages} packages"
                )
                sys.stderr.flush()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_S)
    if sys.stderr.isatty():
        sys.stderr.write(ERASE)
    return process.returncode


def main(
    extras: list[str],
    *,
    keeps_bytecode: bool = not sys.dont_write_bytecode,
    run: Callable[..., int] = logged,
) -> int:
    """Install the project with these extras by uv, or by pip; return the exit code."""
    project = f".[{','.join(extras)}]"
    LOG.unlink(missing_ok=True)
    began_s = time.monotonic()
    if not sys.stderr.isatty():
        print(f"installing into .venv: {project}", flush=True)
    if run([*PIP, "--quiet", "uv>=0.9"]) == 0:
        bytecode = () if keeps_bytecode else ("--compile-bytecode",)
        command = [*UV, "install", *bytecode, "--python", sys.executable, "-e", project]
        env = environment()
        if run([*command, "-c", LOCK, "-b", LOCK], env={**env, "UV_INDEX_STRATEGY": "unsafe-best-match"}) == 0:
            return done(project, began_s)
        if LOG.exists() and WRONG_HASH in LOG.read_bytes():
            print(f"a file that a package index gave is not the one of {LOCK}: see {LOG}", file=sys.stderr)
            return 1
        print(f"the package indexes lack a version of {LOCK}: the newest that pyproject.toml allows", flush=True)
        if run(command, env=env) == 0:
            return done(project, began_s)
    print("without uv: pip installs, which takes a minute or two", flush=True)
    bytecode = "--no-compile" if keeps_bytecode else "--compile"
    if code := run([*PIP, bytecode, "-e", project]):
        print(f"the installation failed; the end of {LOG}:\n{tail()}", file=sys.stderr)
        return code
    return done(project, began_s)


def done(project: str, began_s: float) -> int:
    """Print one line about the installation, and return 0."""
    print(f"installed into .venv: {project}, {time.monotonic() - began_s:.0f} s; log: {LOG}", flush=True)
    return 0


def tail() -> str:
    """Return the last lines of the log."""
    return "\n".join(LOG.read_text(encoding="utf-8", errors="replace").splitlines()[-SHOWN_LINES:])


if __name__ == "__main__":
    sys.exit(lock() if sys.argv[1:] == ["--lock"] else main(sys.argv[1:]))
