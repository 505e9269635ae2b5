"""Checkpoint of a controller: what another process continues from, and when it may be armed."""

from __future__ import annotations

import io
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Authority, ControllerState, ControllerStatus, Plan
from services.bus.wire import to_map
from services.processes import checkpoint as module
from services.processes.checkpoint import DRIVEN, FILE, Checkpoint, Damaged, Stamp, parse, serialised
from services.runtime.clock import boot_id
from services.runtime.console import Console
from tests.services.bus.messages import CONTROLLER_STATE, EXAMPLES, HEADER
from tests.waiting import until

S_US, S_NS = 1_000_000, 1_000_000_000
POINT = 'kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n'
PLAN = next(e for e in EXAMPLES if isinstance(e, Plan))
STATUS = next(e for e in EXAMPLES if isinstance(e, ControllerStatus))
ARMED = msgspec.structs.replace(CONTROLLER_STATE, t_ns=100 * S_NS, schedule_t_ns=100 * S_NS, plan=PLAN)
KEPT_US = 7 * S_US
"""Monotonic time at which a state is kept."""

Opener = Callable[..., Checkpoint]
Said = Callable[[], list[str]]


def state(authority: Authority) -> ControllerState:
    return msgspec.structs.replace(ARMED, authority=authority)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / FILE


@pytest.fixture
def log() -> io.StringIO:
    return io.StringIO()


@pytest.fixture
def said(log: io.StringIO) -> Said:
    """Return a function that returns the texts on the console."""
    return lambda: [json.loads(line)["text"] for line in log.getvalue().splitlines()]


@pytest.fixture
def opened(path: Path, log: io.StringIO) -> Iterator[Opener]:
    """Return a function that opens the checkpoint as a new process does, after the one before is closed."""
    last: list[Checkpoint] = []

    def new(reference: str = POINT, resume_within_s: float | None = 60.0) -> Checkpoint:
        while last:
            last.pop().close()
        console = Console("controller", as_json=True, out=log)
        last.append(Checkpoint(path.parent, reference, resume_within_s=resume_within_s, console=console))
        return last[0]

    yield new
    while last:
        last.pop().close()


def restored(checkpoint: Checkpoint, age_s: float = 3.0, *, set_by_s: float = 0.0, own_clock: bool = True) -> Any:
    """Return the state that a process continues from whose first cycle is ``age_s`` after the state was kept."""
    t_ns = ARMED.t_ns + round((age_s + set_by_s) * S_NS)
    return checkpoint.restored(t_ns, KEPT_US + round(age_s * S_US), own_clock=own_clock)


def test_the_state_is_restored_once_and_whole(opened: Opener, said: Said) -> None:
    assert restored(opened()) is None
    assert said() == []
    opened().keep(ARMED, KEPT_US)
    checkpoint = opened()
    found, before = (to_map(one, HEADER) for one in (restored(checkpoint), ARMED))
    assert found == before | {"estimate": None}
    assert restored(checkpoint) is None


LONG_AGO_S = 60.1
STOPPED = Authority.DISARMED, Authority.STOPPED


@pytest.mark.parametrize(
    ("kept", "within_s", "age_s", "authority", "text"),
    [
        *[(kept, None, 3.0, Authority.DISARMED, "(--resume-armed is not set); `arm` continues the") for kept in DRIVEN],
        *[(kept, 60.0, 3.0, kept, "") for kept in DRIVEN],
        *[(kept, 60.0, LONG_AGO_S, Authority.DISARMED, "older than 60 s") for kept in DRIVEN],
        *[(kept, within_s, 3.0, kept, "") for kept in STOPPED for within_s in (None, 60.0)],
    ],
)
def test_a_young_checkpoint_arms_if_resuming_is_allowed_and_never_after_stop_or_disarm(
    kept: Authority, within_s: float | None, age_s: float, authority: Authority, text: str, opened: Opener, said: Said
) -> None:
    """The age counts at the first cycle: a controller that waits for its estimates must not drive off with them."""
    checkpoint = opened()
    checkpoint.keep(ARMED, KEPT_US)
    checkpoint.keep(state(kept), KEPT_US)
    found = restored(opened(resume_within_s=within_s), age_s)
    assert (found.authority, found.arm_continues) == (authority, authority is not kept)
    assert text in said()[-1]


@pytest.mark.parametrize("authority", [Authority.CONTROLLER, Authority.STOPPED])
def test_after_a_reboot_nothing_arms_and_no_time_or_position_is_used(authority, opened, said, path) -> None:
    opened().keep(state(authority), KEPT_US)
    opened()  # the first one has written
    stamp, kept = parse(path.read_bytes())
    assert stamp.boot_id == boot_id()
    path.write_bytes(serialised(msgspec.structs.replace(stamp, boot_id="another"), kept))
    found = restored(opened())
    assert found.authority is (Authority.STOPPED if authority is Authority.STOPPED else Authority.DISARMED)
    assert found.t_ns == ARMED.t_ns + 3 * S_NS
    assert (found.reference_start, found.plan, found.arm_continues) == (None, None, False)
    assert (found.reference_toml, found.depth_integral_N) == (ARMED.reference_toml, ARMED.depth_integral_N)
    assert "before a reboot" in said()[-1]


@pytest.mark.parametrize(
    ("set_by_s", "own_clock", "moved_s"),
    [(0.0, True, 0.0), (0.3, True, 0.0), (-5.0, True, -5.0), (86_400.0, True, 86_400.0), (27.0, False, 0.0)],
)
def test_a_clock_that_was_set_meanwhile_moves_all_times_and_a_shared_one_none(
    set_by_s: float, own_clock: bool, moved_s: float, opened: Opener
) -> None:
    """A shared clock may run at another speed."""
    opened().keep(ARMED, KEPT_US)
    found = restored(opened(), set_by_s=set_by_s, own_clock=own_clock)
    moved_ns = round(moved_s * S_NS)
    assert found.t_ns - ARMED.t_ns == found.schedule_t_ns - ARMED.schedule_t_ns == moved_ns
    np.testing.assert_array_equal(found.plan.t_ns, PLAN.t_ns + moved_ns)


def test_a_checkpoint_that_is_damaged_or_of_another_reference_is_reported_and_not_used(opened, said, path) -> None:
    opened().keep(ARMED, KEPT_US)
    assert restored(opened(reference='kind = "hold"\n')) is None
    assert "another --reference" in said()[-1]
    whole = path.read_bytes()
    for damaged in (b"", whole[:40], whole[:-1], whole.replace(b"state 1", b"state 2", 1), bytes(len(whole))):
        path.write_bytes(damaged)
        assert restored(opened()) is None
        assert f"{path} is not used: it is" in said()[-1]
    assert len(said()) == 6


def test_no_damage_of_one_byte_is_accepted_nor_an_impossible_state() -> None:
    stamp = Stamp(boot_id="a", written_us=1, reference_crc=2)
    whole = serialised(stamp, ARMED)
    assert parse(whole)[1].t_ns == ARMED.t_ns
    for k in range(0, len(whole), 7):
        with pytest.raises(Damaged):
            parse(whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :])
    with pytest.raises(Damaged, match="cannot be read"):
        parse(serialised(stamp, msgspec.structs.replace(ARMED, model_products=np.ones((3, 4)))))


# --- the disk --------------------------------------------------------------------------------------------------------


@contextmanager
def hanging_disk(draft: Path) -> Iterator[None]:
    """Let writing hang within the context: the draft is a pipe without a reader. Then it fails."""
    os.mkfifo(draft)
    try:
        yield
    finally:
        os.close(os.open(draft, os.O_RDONLY | os.O_NONBLOCK))


def test_stop_and_disarm_wait_for_the_disk_and_cycles_do_not(opened: Opener, path: Path, said: Said) -> None:
    checkpoint = opened()
    checkpoint.keep(ARMED, KEPT_US)
    until(path.exists)
    with hanging_disk(path.with_suffix(".state.part")):
        checkpoint.keep(ARMED, KEPT_US)  # returns at once
        begin_s = time.monotonic()
        checkpoint.keep(state(Authority.STOPPED), KEPT_US)
        assert time.monotonic() - begin_s >= module.MAX_WAIT_S
        assert path.exists()
        checkpoint.show(STATUS)
        assert "the disk does not answer within 1 s" in said()[-1]
    checkpoint.keep(state(Authority.DISARMED), KEPT_US)
    assert parse(path.read_bytes())[1].authority is Authority.DISARMED


@pytest.mark.parametrize("authority", [Authority.CONTROLLER, Authority.STOPPED])
def test_if_writing_fails_no_checkpoint_is_left_that_arms_after_a_stop(authority, opened, said, path) -> None:
    """The failure is counted and reported once, and so is its end."""
    draft = path.with_suffix(".state.part")
    checkpoint = opened()
    checkpoint.keep(state(Authority.MANUAL), KEPT_US)
    until(path.exists)
    draft.mkdir()  # in the way, as a full disk is
    for failures in (1, 2):
        checkpoint.keep(state(authority), KEPT_US)
        until(lambda failures=failures: checkpoint.failures == failures)  # type: ignore[misc]
        checkpoint.show(STATUS)
    assert said() == ["the checkpoint cannot be written: Is a directory; the controller continues without it"]
    assert path.exists() == (authority is Authority.CONTROLLER)
    draft.rmdir()
    checkpoint.keep(state(authority), KEPT_US)
    opened()  # the other one has written
    assert parse(path.read_bytes())[1].authority is authority
    checkpoint.show(STATUS)
    assert said()[1:] == ["the checkpoint is written again"]


def test_a_folder_of_another_controller_or_that_cannot_be_written_is_refused(opened: Opener, path: Path) -> None:
    opened()
    (path.parent / "file").write_text("in the way")
    for folder, problem in (
        (path.parent, "option --state: .*: another controller keeps its checkpoint there"),
        (path.parent / "file", "option --state"),
        (path.parent / "file" / "state", "option --state"),
        (Path("/proc/ltv-mpc"), "option --state"),
    ):
        with pytest.raises(ConfigError, match=problem):
            Checkpoint(folder, POINT, resume_within_s=None, console=Console("controller"))
