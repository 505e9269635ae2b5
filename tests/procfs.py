"""Processes of this machine, as /proc shows them."""

from __future__ import annotations

from pathlib import Path


def stat(pid: int) -> list[str]:
    """Return state, parent, group, session, ..."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def alive(pid: int) -> bool:
    try:
        return stat(pid)[0] != "Z"
    except OSError:
        return False


def children_of(parent: int) -> dict[int, str]:
    """Return pid and command line of every living child.

    Multiprocessing's resource tracker, which other tests leave to a test worker, does not belong to the supervisor.
    """
    children = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if stat(int(entry.name))[1] == str(parent):
                children[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue
    return {pid: words for pid, words in children.items() if words and "multiprocessing.resource_tracker" not in words}


def pid_of(name: str, launcher: int) -> int:
    """Return the pid of a run's process, by its process name."""
    (pid,) = (pid for pid in children_of(launcher) if Path(f"/proc/{pid}/comm").read_text() == f"ltv-{name}\n")
    return pid
