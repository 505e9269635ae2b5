"""Checkpoint of a controller: what another process continues from, and when it may be armed."""

from __future__ import annotations

import io
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Authority, ControllerState, ControllerStatus, Plan
from services.processes import checkpoint as module
from services.processes.checkpoint import FILE, Checkpoint, Damaged, Stamp, parse, serialised
from services.runtime.clock import boot_id
from services.runtime.console import Console
from tests.services.bus.messages import CONTROLLER_STATE, EXAMPLES
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
def log() -> io.StringIO:
    return io.StringIO()


@pytest.fixture
def said(log: io.StringIO) -> Said:
    """Return a function that returns the texts on the console."""
    return lambda: [json.loads(line)["text"] for line in log.getvalue().splitlines()]


@pytest.fixture
def opened(tmp_path: Path, log: io.StringIO) -> Iterator[Opener]:
    """Return a function that opens the checkpoint as a new process does, after the one before is closed."""
    last: list[Checkpoint] = []

    def new(reference: str = POINT, resume_within_s: float | None = 60.0) -> Checkpoint:
        while last:
            last.pop().close()
        console = Console("controller", as_json=True, out=log)
        last.append(Checkpoint(tmp_path / "state", reference, resume_within_s=resume_within_s, console=console))
        return last[0]

    yield new
    while last:
        last.pop().close()


def restored(checkpoint: Checkpoint, age_s: float = 3.0, *, set_by_s: float = 0.0) -> ControllerState | None:
    """Return the state that a process continues from whose first cycle is ``age_s`` after the state was kept."""
    t_ns = ARMED.t_ns + round((age_s + set_by_s) * S_NS)
    return checkpoint.restored(t_ns, KEPT_US + round(age_s * S_US), own_clock=True)


def test_without_a_checkpoint_there_is_nothing_to_continue_from(opened: Opener, said: Said) -> None:
    assert restored(opened()) is None
    assert said() == []


def test_the_state_is_restored_once_and_whole(opened: Opener) -> None:
    opened().keep(ARMED, KEPT_US)
    checkpoint = opened()
    found = restored(checkpoint)
    assert found is not None
    assert found.plan is not None
    np.testing.assert_array_equal(found.plan.thrust_N, PLAN.thrust_N)
    np.testing.assert_array_equal(found.model_products, ARMED.model_products)
    np.testing.assert_array_equal(found.disturbance.covariance, ARMED.disturbance.covariance)
    for name in set(ControllerState.__struct_fields__) - {"plan", "model_products", "estimate", "disturbance"}:
        assert getattr(found, name) == getattr(ARMED, name), name
    assert restored(checkpoint) is None


@pytest.mark.parametrize("authority", [Authority.CONTROLLER, Authority.MANUAL])
def test_a_young_checkpoint_arms_only_if_resuming_is_allowed(authority: Authority, opened: Opener, said: Said) -> None:
    opened().keep(state(authority), KEPT_US)
    found = restored(opened(resume_within_s=None))
    assert found is not None
    assert (found.authority, found.arm_continues) == (Authority.DISARMED, True)
    assert "disarmed (--resume-armed is not set); `arm` continues the reference" in said()[-1]
    found = restored(opened(resume_within_s=60.0))
    assert found is not None
    assert (found.authority, found.arm_continues) == (authority, False)


def test_the_age_counts_at_the_first_cycle_and_not_at_the_start(opened: Opener, said: Said) -> None:
    """A controller that waits a minute for its estimates must not drive off when they come."""
    opened().keep(ARMED, KEPT_US)
    found = restored(opened(), age_s=60.1)
    assert found is not None
    assert found.authority is Authority.DISARMED
    assert "older than 60 s" in said()[-1]
    found = restored(opened(), age_s=59.9)
    assert found is not None
    assert found.authority is Authority.CONTROLLER


@pytest.mark.parametrize("authority", [Authority.DISARMED, Authority.STOPPED])
def test_after_stop_or_disarm_nothing_arms_and_arm_starts_the_reference(authority: Authority, opened: Opener) -> None:
    checkpoint = opened()
    checkpoint.keep(ARMED, KEPT_US)
    checkpoint.keep(state(authority), KEPT_US)
    found = restored(opened())
    assert found is not None
    assert (found.authority, found.arm_continues) == (authority, False)


@pytest.mark.parametrize("authority", [Authority.CONTROLLER, Authority.STOPPED])
def test_after_a_reboot_nothing_arms_and_no_time_or_position_is_used(
    authority: Authority, opened: Opener, said: Said, tmp_path: Path
) -> None:
    opened().keep(state(authority), KEPT_US)
    opened()  # the first one has written
    path = tmp_path / "state" / FILE
    stamp, kept = parse(path.read_bytes())
    assert stamp.boot_id == boot_id()
    path.write_bytes(serialised(msgspec.structs.replace(stamp, boot_id="another"), kept))
    found = opened().restored(5, KEPT_US + S_US, own_clock=True)
    assert found is not None
    assert found.authority is (Authority.STOPPED if authority is Authority.STOPPED else Authority.DISARMED)
    assert (found.t_ns, found.reference_start, found.plan, found.arm_continues) == (5, None, None, False)
    assert (found.reference_toml, found.depth_integral_N) == (ARMED.reference_toml, ARMED.depth_integral_N)
    assert "before a reboot" in said()[-1]


@pytest.mark.parametrize(("set_by_s", "moved_s"), [(0.0, 0.0), (0.3, 0.0), (-5.0, -5.0), (86_400.0, 86_400.0)])
def test_a_clock_that_was_set_meanwhile_moves_all_times(set_by_s: float, moved_s: float, opened: Opener) -> None:
    opened().keep(ARMED, KEPT_US)
    found = restored(opened(), set_by_s=set_by_s)
    assert found is not None
    assert found.plan is not None
    moved_ns = round(moved_s * S_NS)
    assert found.t_ns - ARMED.t_ns == found.schedule_t_ns - ARMED.schedule_t_ns == moved_ns
    np.testing.assert_array_equal(found.plan.t_ns, PLAN.t_ns + moved_ns)


def test_a_shared_clock_which_may_run_at_another_speed_moves_no_times(opened: Opener) -> None:
    opened().keep(ARMED, KEPT_US)
    found = opened().restored(ARMED.t_ns + 30 * S_NS, KEPT_US + 3 * S_US, own_clock=False)
    assert found is not None
    assert found.t_ns == ARMED.t_ns


def test_a_checkpoint_of_another_reference_is_not_used(opened: Opener, said: Said) -> None:
    opened().keep(ARMED, KEPT_US)
    assert restored(opened(reference='kind = "hold"\n')) is None
    assert "another --reference" in said()[-1]


def test_a_damaged_checkpoint_is_reported_and_not_used(opened: Opener, said: Said, tmp_path: Path) -> None:
    opened().keep(ARMED, KEPT_US)
    opened()  # the first one has written
    path = tmp_path / "state" / FILE
    whole = path.read_bytes()
    for damaged in (b"", whole[:40], whole[:-1], whole.replace(b"state 1", b"state 2", 1), bytes(len(whole))):
        path.write_bytes(damaged)
        assert restored(opened()) is None
        assert f"{path} is not used: it is" in said()[-1]
    assert len(said()) == 5


def test_no_damage_of_one_byte_is_accepted() -> None:
    whole = serialised(Stamp(boot_id="a", written_us=1, reference_crc=2), ARMED)
    assert parse(whole)[1].t_ns == ARMED.t_ns
    for k in range(0, len(whole), 7):
        with pytest.raises(Damaged):
            parse(whole[:k] + bytes([whole[k] ^ 1]) + whole[k + 1 :])


def test_a_whole_file_with_an_impossible_state_is_not_used() -> None:
    impossible = msgspec.structs.replace(ARMED, model_products=np.ones((3, 4)))
    with pytest.raises(Damaged, match="cannot be read"):
        parse(serialised(Stamp(boot_id="a", written_us=1, reference_crc=2), impossible))


# --- the disk --------------------------------------------------------------------------------------------------------


@contextmanager
def hanging_disk(draft: Path) -> Iterator[None]:
    """Let writing hang within the context: the draft is a pipe without a reader. Then it fails."""
    os.mkfifo(draft)
    try:
        yield
    finally:
        os.close(os.open(draft, os.O_RDONLY | os.O_NONBLOCK))


def test_stop_and_disarm_wait_for_the_disk_and_cycles_do_not(opened: Opener, tmp_path: Path) -> None:
    path = tmp_path / "state" / FILE
    checkpoint = opened()
    checkpoint.keep(ARMED, KEPT_US)
    until(path.exists)
    with hanging_disk(path.with_suffix(".state.part")):
        checkpoint.keep(ARMED, KEPT_US)  # returns at once
        begin_s = time.monotonic()
        checkpoint.keep(state(Authority.STOPPED), KEPT_US)
        assert time.monotonic() - begin_s >= module.MAX_WAIT_S
        assert path.exists()
    checkpoint.keep(state(Authority.DISARMED), KEPT_US)
    assert parse(path.read_bytes())[1].authority is Authority.DISARMED


def test_a_disk_that_hangs_is_reported(opened: Opener, tmp_path: Path, said: Said) -> None:
    checkpoint = opened()
    with hanging_disk(tmp_path / "state" / f"{FILE}.part"):
        checkpoint.keep(state(Authority.STOPPED), KEPT_US)
        checkpoint.show(STATUS)
    assert "the disk does not answer within 1 s" in said()[-1]


@pytest.mark.parametrize("authority", [Authority.CONTROLLER, Authority.STOPPED])
def test_if_writing_fails_no_checkpoint_is_left_that_arms_after_a_stop(
    authority: Authority, opened: Opener, said: Said, tmp_path: Path
) -> None:
    """The failure is counted and reported once, and so is its end."""
    path = tmp_path / "state" / FILE
    draft = tmp_path / "state" / f"{FILE}.part"
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


def test_two_controllers_do_not_share_a_folder(opened: Opener, tmp_path: Path) -> None:
    opened()
    with pytest.raises(ConfigError, match=r"option --state: .*: another controller keeps its checkpoint there"):
        Checkpoint(tmp_path / "state", POINT, resume_within_s=None, console=Console("controller"))


def test_a_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for folder in (tmp_path / "file", tmp_path / "file" / "state", Path("/proc/ltv-mpc")):
        with pytest.raises(ConfigError, match="option --state"):
            Checkpoint(folder, POINT, resume_within_s=None, console=Console("controller"))
