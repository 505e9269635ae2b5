"""Conversion of a message's times: every time changes, nothing else does."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Applied, ControllerState, ControllerStatus, FenceInForce, Message, Obstacles, Plan
from services.bus.time_shift import shifted
from services.bus.wire import to_map
from tests.services.bus.messages import EXAMPLES, HEADER

SHIFT_NS = -86_400_000_000_000
EXAMPLE = {type(message): message for message in EXAMPLES}


def changed(before: Message, after: Message) -> set[str]:
    """Return the names of the fields that differ."""
    one, other = to_map(before, HEADER), to_map(after, HEADER)
    return {name for name in one if one[name] != other[name]}


@pytest.mark.parametrize(
    ("kind", "times"),
    [
        (Plan, {"cycle_t_ns", "t_ns", "estimate_t_ns"}),
        (Applied, {"t_ns", "plan_cycle_t_ns", "plan_received_t_ns"}),
        (ControllerStatus, {"t_ns"}),
    ],
)
def test_the_times_of_a_message_change_and_nothing_else(kind, times):
    before = EXAMPLE[kind]
    after = shifted(before, SHIFT_NS)
    assert changed(before, after) == times
    for name in times:
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name) + SHIFT_NS)
    assert shifted(before, 0) is before


def test_the_plan_in_a_state_changes_with_it():
    state = EXAMPLE[ControllerState]
    assert isinstance(state, ControllerState)
    state = msgspec.structs.replace(state, plan=EXAMPLE[Plan])
    after = shifted(state, SHIFT_NS)
    assert after.plan.cycle_t_ns == state.plan.cycle_t_ns + SHIFT_NS
    assert after.schedule_t_ns == state.schedule_t_ns + SHIFT_NS


@pytest.mark.parametrize("kind", [Obstacles, FenceInForce])
def test_the_times_of_obstacles_change_with_that_of_their_message(kind):
    """Otherwise a display predicts them over the difference of two clocks."""
    message = EXAMPLE[kind]
    after = shifted(message, SHIFT_NS)
    assert after.t_ns == message.t_ns + SHIFT_NS
    (ship,), (before,) = after.obstacles, message.obstacles
    assert ship == msgspec.structs.replace(before, t_ns=before.t_ns + SHIFT_NS)
