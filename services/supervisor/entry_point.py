"""Entry point of every process of a run.

    python -P -m services.supervisor.entry_point PARENT MODULE CONFIG [LIFELINE]

MODULE has a struct ``Config`` and a function ``main(config) -> exit code``. CONFIG is a file that holds the config as
JSON; the process is named after it. The process ends with its PARENT (a pid). LIFELINE is the descriptor of
the socket to a supervisor (``services/runtime/lifeline.py``). A forked process calls ``run`` with the same arguments.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import sys
from pathlib import Path
from typing import Any

import msgspec

from services.supervisor.parent_death import die_with_parent

PR_SET_NAME = 15
RECORDER = "recorder"
BAD_INPUT = 2


def write_config(path: Path, config: msgspec.Struct) -> None:
    """Write the file that ``run`` reads."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(config, enc_hook=os.fspath)))


def read_config(path: Path, kind: type[Any]) -> Any:
    """Read the config of a process. Raises ``OSError``, ``msgspec.DecodeError``."""
    return msgspec.json.decode(path.read_bytes(), type=kind, dec_hook=lambda wanted, text: wanted(text))


def run(parent: str, module: str, config: str, lifeline: str = "") -> int:
    """Run the process and return its exit code: that of ``main``, or 2 if a setting is rejected.

    The recorder is not killed at its parent's death: it finishes its file.
    """
    name = Path(config).stem
    die_with_parent(int(parent), signal.SIGTERM if name == RECORDER else signal.SIGKILL)
    name_process(f"ltv-{name}")

    from ltv_mpc.errors import ConfigError
    from services.runtime.console import escape_output
    from services.runtime.lifeline import LIFELINE

    if lifeline:
        LIFELINE.connect_to_supervisor(int(lifeline))
    escape_output()
    node = importlib.import_module(module)
    try:
        code: int = node.main(read_config(Path(config), node.Config))
    except (ConfigError, msgspec.ValidationError) as error:
        sys.stderr.write(f"ltv-mpc: {error}\n")
        return BAD_INPUT
    return code


def name_process(name: str) -> None:
    """Set the name that ``ps`` and ``top`` show; at most 15 characters."""
    ctypes.CDLL(None).prctl(PR_SET_NAME, name.encode())


if __name__ == "__main__":
    sys.exit(run(*sys.argv[1:]))
