"""Checkpoint of a controller that runs alone: a file from which the controller that replaces it continues.

    ltv-mpc state 1 <CRC-32 of the rest>
    {"boot_id": ..., "written_us": ..., "reference_crc": ...}
    the state as it is published on ``state/controller``

The file is replaced atomically, by another thread, so that a slow disk delays no cycle. Only a state that takes the
thrusters away from the controller is waited for: it is on disk before ``stop`` or ``disarm`` is acknowledged, or else
no checkpoint is left that could arm the vehicle again.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import queue
import threading
import zlib
from pathlib import Path
from typing import NamedTuple

import msgspec

from ltv_mpc.config import read_bytes
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Authority, ControllerState, ControllerStatus, Message
from services.bus.time_shift import shifted
from services.bus.wire import MAX_PAYLOAD_BYTES, Header, decode, encode
from services.run.folder import draft_of
from services.runtime.clock import NO_BOOT_ID, boot_id
from services.runtime.console import Console, Level

FILE = "controller.state"
MAGIC = b"ltv-mpc state "
FORMAT = 1
DRIVEN = (Authority.CONTROLLER, Authority.MANUAL)
"""Authorities under which thrusters are driven."""

MAX_WAIT_S = 1.0
"""Longest time that a command waits for the disk. The plan that it causes has been sent before."""

CLOCK_SET_NS = 1_000_000_000
"""Difference of vehicle time and the host's clock beyond which the vehicle's clock was set between two processes."""

MAX_BYTES = 2 * MAX_PAYLOAD_BYTES
"""Largest size of a checkpoint: a frame, and its stamp."""


class Stamp(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Origin of a checkpoint."""

    boot_id: str  # of the host
    written_us: int  # monotonic time
    reference_crc: int  # of the reference that the process was started with


class Damaged(ValueError):
    """Checkpoint that cannot be used; the text is the reason."""


class Checkpoint:
    """Checkpoint in a folder, which it reserves for this process."""

    def __init__(self, folder: Path, reference_toml: str, *, resume_within_s: float | None, console: Console) -> None:
        """Reserve the folder and read the checkpoint in it. Raises ``ConfigError`` if it cannot be written.

        ``reference_toml`` is the reference that this process is started with: a checkpoint of another one is not used.
        ``resume_within_s`` is the largest age of a checkpoint that arms the vehicle; None: none does.
        """
        self.failures = 0
        """States that could not be written."""
        self._path = folder / FILE
        self._reference_crc = zlib.crc32(reference_toml.encode())
        self._resume_within_s = resume_within_s
        self._console = console
        self._problem, self._reported = "", ""  # of the last write; as it was reported last
        self._newest: _Job | None = None  # state that was kept last
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._folder = _reserve(folder)
        self._found = self._read()
        self._thread = threading.Thread(target=self._run, name="checkpoint", daemon=True)
        self._thread.start()

    def restored(self, t_ns: int, now_us: int, *, own_clock: bool) -> ControllerState | None:
        """Return the state to continue from. It is armed only if the conditions to resume hold at this time."""
        if self._found is None:
            return None
        (stamp, state), self._found = self._found, None
        # A newer estimate is in the same inbox, or none has arrived.
        state = msgspec.structs.replace(state, estimate=None)
        if stamp.boot_id != boot_id() or stamp.boot_id == NO_BOOT_ID:
            self._console.say("the checkpoint is from before a reboot: not armed, `arm` starts the reference again")
            return _after_reboot(state, t_ns)
        age_us = now_us - stamp.written_us
        set_by_ns = t_ns - age_us * 1000 - state.t_ns
        if own_clock and abs(set_by_ns) > CLOCK_SET_NS:
            state = shifted(state, set_by_ns)
        why = self._why_not_armed(age_us * 1e-6)
        if state.authority in DRIVEN and why:
            state = msgspec.structs.replace(state, authority=Authority.DISARMED, arm_continues=True)
        text = f"continuing from the checkpoint of {age_us * 1e-6:.1f} s ago, {state.authority.value}"
        if state.arm_continues:
            text += f" ({why}); `arm` continues the reference" if why else "; `arm` continues the reference"
        self._console.say(text)
        return state

    def keep(self, state: Message, now_us: int) -> None:
        """Write a state; wait for the disk if no thruster is driven any more."""
        assert isinstance(state, ControllerState)
        stamp = Stamp(boot_id=boot_id(), written_us=now_us, reference_crc=self._reference_crc)
        before, self._newest = self._newest, _Job(state, stamp, threading.Event())
        self._jobs.put(self._newest)
        changed = before is None or state.authority is not before.state.authority
        if changed and state.authority not in DRIVEN and not self._newest.done.wait(MAX_WAIT_S):
            self._problem = f"the disk does not answer within {MAX_WAIT_S:g} s"

    def show(self, status: ControllerStatus) -> None:
        """Print a problem of the disk when it begins and when it ends."""
        problem = self._problem
        if problem != self._reported:
            self._reported = problem
            text = f"the checkpoint cannot be written: {problem}; the controller continues without it"
            level, text = (Level.WARNING, text) if problem else (Level.INFO, "the checkpoint is written again")
            self._console.tell(level, "checkpoint", text, t_ns=status.t_ns, fields={"failures": self.failures})

    def close(self) -> None:
        """Finish writing, and release the folder."""
        self._jobs.put(None)
        self._thread.join(MAX_WAIT_S)
        if not self._thread.is_alive():
            os.close(self._folder)

    # --- the file ---

    def _why_not_armed(self, age_s: float) -> str:
        limit_s = self._resume_within_s
        if limit_s is None:
            return "--resume-armed is not set"
        return f"the checkpoint is older than {limit_s:g} s" if age_s > limit_s else ""

    def _read(self) -> tuple[Stamp, ControllerState] | None:
        """Return the checkpoint in the folder, or None: there is none, it is damaged, or of another reference."""
        if not self._path.exists():
            return None
        try:
            stamp, state = parse(read_bytes(self._path, what="checkpoint", max_bytes=MAX_BYTES))
        except ValueError as error:  # ConfigError, Damaged
            self._console.say(f"{self._path} is not used: {getattr(error, 'problem', error)}")
            return None
        if stamp.reference_crc != self._reference_crc:
            self._console.say(f"{self._path} is not used: it is of another --reference")
            return None
        return stamp, state

    def _run(self) -> None:
        """Write the newest state again and again, in the thread of the disk."""
        while (job := self._jobs.get()) is not None:
            if job is self._newest:  # else a newer one replaces it
                self._problem = self._write(job)
            job.done.set()

    def _write(self, job: _Job) -> str:
        """Replace the file. Return what failed; empty if nothing did."""
        try:
            write(self._path, self._folder, serialised(job.stamp, job.state))
        except OSError as error:
            self.failures += 1
            if job.state.authority not in DRIVEN:
                with contextlib.suppress(OSError):  # also a full disk can delete
                    self._path.unlink(missing_ok=True)
                    os.fsync(self._folder)
            return error.strerror or str(error)
        return ""


class _Job(NamedTuple):
    """State to write, and what is set once that is done."""

    state: ControllerState
    stamp: Stamp
    done: threading.Event


def serialised(stamp: Stamp, state: ControllerState) -> bytes:
    """Return the contents of the file."""
    rest = msgspec.json.encode(stamp) + b"\n" + encode(state, Header(epoch=0, sequence=0))
    return MAGIC + b"%d %08x\n" % (FORMAT, zlib.crc32(rest)) + rest


def parse(contents: bytes) -> tuple[Stamp, ControllerState]:
    """Return what ``serialised`` has written. Raises ``Damaged``."""
    head, _, rest = contents.partition(b"\n")
    if not head.startswith(MAGIC + b"%d " % FORMAT):
        raise Damaged(f"it is no checkpoint of format {FORMAT}")
    if head != MAGIC + b"%d %08x" % (FORMAT, zlib.crc32(rest)):
        raise Damaged("it is damaged: its checksum does not match")
    stamp, _, payload = rest.partition(b"\n")
    try:
        return msgspec.json.decode(stamp, type=Stamp), decode(ControllerState, payload)[0]
    except (ValueError, RecursionError) as error:
        raise Damaged(f"it cannot be read: {error}") from None


def write(path: Path, folder: int, contents: bytes) -> None:
    """Replace a file so that a crash at any time leaves the old one or the new one. ``folder`` is its open folder."""
    with draft_of(path) as draft, draft.open("wb") as file:
        file.write(contents)
        file.flush()
        os.fsync(file.fileno())
    os.fsync(folder)


def _after_reboot(state: ControllerState, t_ns: int) -> ControllerState:
    """Return what a state still says after a reboot: clock, origin of the positions and current may be others."""
    stopped = state.authority is Authority.STOPPED
    return ControllerState(
        t_ns=t_ns,
        authority=Authority.STOPPED if stopped else Authority.DISARMED,
        reference_toml=state.reference_toml,
        depth_integral_N=state.depth_integral_N,
        model_products=state.model_products,
    )


def _reserve(folder: Path) -> int:
    """Create the folder, check that a file can be written there, and lock it. Raises ``ConfigError``."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        probe = folder / "probe"
        write(probe, opened, b"0")
        probe.unlink()
    except BlockingIOError:
        problem = "another controller keeps its checkpoint there: name another folder for each controller"
        raise ConfigError("option --state", "", problem, value=str(folder)) from None
    except OSError as error:
        problem = f"cannot be written: {error.strerror}; name a folder in which this user may write"
        raise ConfigError("option --state", "", problem, value=str(folder)) from None
    return opened
