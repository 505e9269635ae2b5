"""Registry of the peers that are installed."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

from benchmarks.peers.peer import Peer

FILES = {
    "with_qpmpc": ("QpmpcDaqp", ("qpmpc", "daqp")),
    "with_casadi": ("CasadiIpopt", ("casadi",)),
    "with_acados": ("AcadosRti", ("acados", "casadi")),
    "with_do_mpc": ("DoMpcIpopt", ("do_mpc", "casadi")),
}
"""File, class, and what it imports."""


def installed() -> tuple[list[type[Peer]], list[str]]:
    """Return the peers, and the files of those whose packages are missing."""
    there, missing = [], []
    for file, (name, needs) in FILES.items():
        if all(find_spec(package) for package in needs):
            there.append(getattr(import_module(f"benchmarks.peers.{file}"), name))
        else:
            missing.append(file)
    return there, missing
