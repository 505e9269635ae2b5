"""Five thousand hostile frames for every reader of external data; ``make fuzz`` sends a million."""

from __future__ import annotations

import pytest

from tests.fuzz import campaign
from tests.fuzz.targets import all_targets

FRAMES = 5_000
SEED = 1


@pytest.mark.filterwarnings("error")
def test_no_reader_crashes_or_lets_a_wrong_value_in_or_takes_memory_without_end() -> None:
    targets = all_targets()
    for target, frames in zip(targets, campaign.shares(targets, FRAMES), strict=True):
        account = campaign.attack(target, frames, SEED)
        assert account.failures == []
        assert 0 < account.accepted <= account.frames, f"{target.name} was not reached behind its first check"
