"""Command arbiter: every path through the states, and the validity of a pilot's messages."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.messages import Action
from ltv_mpc.safety.command_arbiter import MANUAL_TIMEOUT_NS, CommandArbiter
from ltv_mpc.vehicle.parameters import Vehicle

VEHICLE = Vehicle.load("paper")  # +-62.5 N
S = 1_000_000_000

AFTER = {
    "disarmed": {"arm": "controller", "stop": "stopped", "manual": "", "release": ""},
    "controller": {"disarm": "disarmed", "stop": "stopped", "manual": "manual", "release": ""},
    "manual": {"arm": "", "disarm": "disarmed", "stop": "stopped", "release": "controller"},
    "stopped": {"arm": "controller", "disarm": "", "manual": "", "release": ""},
}
"""State after an action by the state before it; empty: refused. All other actions leave the state as it is."""


def test_every_path_of_four_actions_leads_to_its_state():
    for path in product(Action, repeat=4):
        arbiter, authority = CommandArbiter(VEHICLE), "disarmed"
        for action in path:
            after = AFTER[authority].get(action.value, authority)
            result, authority = arbiter.request(action), after or authority
            assert (result.authority, bool(result.why)) == (authority, not after), path


@given(st.lists(st.sampled_from(sorted(Action)), max_size=30))
def test_after_a_stop_no_thrust_is_commanded_until_an_arm(path):
    arbiter = CommandArbiter(VEHICLE)
    arbiter.request(Action.ARM)
    arbiter.request(Action.STOP)
    for k, action in enumerate(path):
        if action is Action.ARM:
            return
        arbiter.request(action)
        arbiter.receive_manual((10.0, 10.0, 10.0), k)
        override = arbiter.override(k)
        assert override is not None
        assert not override.targets(np.array([k, k + 1])).any()


def piloted() -> CommandArbiter:
    arbiter = CommandArbiter(VEHICLE)
    arbiter.request(Action.ARM)
    arbiter.request(Action.MANUAL)
    return arbiter


def test_a_pilots_message_is_valid_for_a_second_and_so_are_its_targets():
    arbiter = piloted()
    arbiter.receive_manual((10.0, -20.0, 30.0), 5 * S)
    override = arbiter.override(5 * S + 400_000_000)
    goal = override.targets(5 * S + 300_000_000 * np.arange(6))
    np.testing.assert_array_equal(goal, [[10.0, -20.0, 30.0]] * 4 + [[0.0, 0.0, 0.0]] * 2)
    assert arbiter.override(5 * S + MANUAL_TIMEOUT_NS).targets(np.array([6 * S])).any()
    silent = arbiter.override(5 * S + MANUAL_TIMEOUT_NS + 1)
    assert not silent.targets(np.array([6 * S])).any()
    assert "no message of the pilot" in silent.why


@pytest.mark.parametrize("side", range(3))
@pytest.mark.parametrize("thrust", [62.6, -62.6, float("nan"), float("inf")])
def test_a_pilots_message_outside_the_box_is_counted_and_the_last_one_stays(side, thrust):
    arbiter = piloted()
    arbiter.receive_manual((1.0, 2.0, 3.0), 0)
    wanted = [0.0, 0.0, 0.0]
    wanted[side] = thrust
    arbiter.receive_manual(tuple(wanted), 1)
    assert arbiter.manual_rejected == 1
    assert arbiter.override(2).thrust_N == (1.0, 2.0, 3.0)
    arbiter.receive_manual((62.5, -62.5, 62.5), 3)
    assert arbiter.override(4).thrust_N == (62.5, -62.5, 62.5)


@pytest.mark.parametrize("path", [(), (Action.ARM,), (Action.ARM, Action.MANUAL, Action.RELEASE)])
def test_a_manual_message_before_the_pilot_has_the_thrusters_has_no_effect(path):
    arbiter = CommandArbiter(VEHICLE)
    for action in path:
        arbiter.request(action)
    arbiter.receive_manual((50.0, 50.0, 50.0), 0)
    arbiter.request(Action.ARM)
    arbiter.request(Action.MANUAL)
    assert not arbiter.override(1).targets(np.array([1, 2])).any()
