"""Ten thousand hostile frames for every reader of external data; ``make fuzz`` sends a million."""

from __future__ import annotations

import pytest

from ltv_mpc.errors import ConfigError
from tests.fuzz import campaign
from tests.fuzz.targets import Target, all_targets, finite

FRAMES = 10_000
SEED = 1

pytestmark = pytest.mark.filterwarnings("error")


def test_no_reader_crashes_or_lets_a_wrong_value_in_or_takes_memory_without_end() -> None:
    result = campaign.run(all_targets(), FRAMES, SEED)
    assert result.frames == FRAMES
    assert [f"{failure.target} {failure.index}: {failure.what}" for failure in result.failures] == []
    assert result.held
    idle = [of.target for of in result.targets if not 0 < of.accepted <= of.frames]
    assert idle == [], "a target that takes nothing was not reached behind its first check"


def target(take: object, name: str = "t") -> Target:
    return Target(name, 1, lambda rng: rng.randbytes(4), take, finite)  # type: ignore[arg-type]


def refuses(_: bytes) -> None:
    return None


def crashes(_: bytes) -> None:
    raise ConfigError("a", "b", "c")


def lets_in(_: bytes) -> dict[str, tuple[float, ...]]:
    return {"x": (1.0, float("nan"))}


def hoards(_: bytes) -> int:
    return len(bytes(campaign.MOST_MEMORY + 1))


def test_a_crash_a_wrong_value_and_a_waste_of_memory_are_each_found() -> None:
    result = campaign.run([target(take, take.__name__) for take in (refuses, crashes, lets_in, hoards)], 40, SEED)
    accounts = {of.target: (of.crashes, of.let_in, of.accepted) for of in result.targets}
    assert accounts == {"refuses": (0, 0, 0), "crashes": (10, 0, 0), "lets_in": (0, 10, 10), "hoards": (0, 0, 10)}
    assert result.beyond_memory == 1  # of the frame that was watched
    assert not result.held


def test_a_frame_can_be_made_again_from_seed_target_and_number() -> None:
    found = campaign.run([target(crashes)], 10, 7).failures[3]
    assert campaign.frame_of(target(crashes), 7, found.index).hex() == found.frame_hex
    assert campaign.frame_of(target(crashes), 8, found.index).hex() != found.frame_hex


def test_frames_are_shared_out_by_weight_to_the_last_one() -> None:
    several = [Target(str(weight), weight, bytes, refuses, finite) for weight in (1, 2, 0.5)]  # type: ignore[arg-type]
    assert campaign.shares(several, 7001) == [2000, 4001, 1000]
