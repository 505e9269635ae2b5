"""Install the project with some of its extras into the environment of the Python that runs this.

uv does in seconds what takes pip a minute or two, half of it for bytecode that is never read: Python keeps that of a
module when it is first imported. Where it is told not to (PYTHONDONTWRITEBYTECODE), every process would compile its
thousand modules again, two seconds each time; there all bytecode is made with the installation. uv is told of the same
sources: pip's settings (index, further indexes, folders, certificates) are handed on, and so is pip's rule of taking
the best version that any of them has. Where uv cannot be had, or does not manage, pip does it.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Callable

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

PIP = (sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")


def sources(settings: str) -> dict[str, str]:
    """Return the output of ``pip config list`` (one ``section.name='value'`` a line) as variables for uv."""
    found: dict[tuple[str, str], str] = {}
    for line in settings.splitlines():
        key, _, value = line.partition("=")
        section, _, name = key.rpartition(".")
        if name in HANDED_ON and section in SECTIONS:
            found[section, name] = str(ast.literal_eval(value))
    given = {"UV_INDEX_STRATEGY": "unsafe-best-match"}
    for section in SECTIONS:
        for name, variable in HANDED_ON.items():
            if (section, name) in found:
                words = found[section, name].split()
                given[variable] = (",".join if name in LISTS_WITH_COMMAS else " ".join)(words)
    return given


def main(
    extras: list[str],
    *,
    keeps_bytecode: bool = not sys.dont_write_bytecode,
    run: Callable[..., subprocess.CompletedProcess[str]] = subprocess.run,
) -> int:
    """Install the project with these extras by uv, or by pip; return the exit code."""
    project = f".[{','.join(extras)}]"
    if run([*PIP, "--quiet", "uv>=0.9"], check=False).returncode == 0:
        listing = [sys.executable, "-m", "pip", "config", "list"]
        settings = run(listing, capture_output=True, text=True, check=False).stdout
        quiet = () if sys.stderr.isatty() else ("--quiet",)  # its bars, or nothing but what goes wrong
        bytecode = () if keeps_bytecode else ("--compile-bytecode",)
        options = (*quiet, *bytecode, "--python", sys.executable)
        command = [sys.executable, "-m", "uv", "pip", "install", *options, "-e", project]
        if run(command, env={**sources(settings), **os.environ}, check=False).returncode == 0:
            return 0
    print("without uv: pip installs, which takes a minute or two", flush=True)
    bytecode = "--no-compile" if keeps_bytecode else "--compile"
    return run([*PIP, bytecode, "-e", project], check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
