"""Mission policy: causes, actions, what is latched and what ends it."""

from __future__ import annotations

import pytest

from ltv_mpc.messages import Battery, Health, Leak, MissionAction
from ltv_mpc.safety.mission_policy import MissionPolicy, MissionSettings

S = 1_000_000_000
GO_ON, HOLD, SURFACE = MissionAction.GO_ON, MissionAction.HOLD, MissionAction.SURFACE


def armed(**settings) -> MissionPolicy:
    policy = MissionPolicy(MissionSettings(**settings))
    policy.hear_operator(0)
    policy.arm(0)
    return policy


def at(policy: MissionPolicy, *seconds: float) -> list[MissionAction]:
    return [policy.update(round(t * S), armed=True) for t in seconds]


def test_by_default_a_mission_ends_with_its_reference():
    policy = armed()
    policy.receive(Leak(detected=True), 0)
    policy.receive(Battery(voltage_V=0.0, remaining=0.0), 0)
    assert at(policy, 1, 1e6) == [GO_ON, GO_ON]
    assert policy.health(1_000_000 * S).health is Health.NOMINAL


@pytest.mark.parametrize("action", [HOLD, SURFACE])
def test_a_silent_operator_has_the_chosen_effect_until_it_is_cleared(action):
    policy = armed(operator_timeout_s=10, on_operator_loss=action)
    assert at(policy, 10, 10.1, 500) == [GO_ON, action, action]
    assert policy.health(500 * S).why == f"{action.value}: no sign of the operator for 10 s"
    assert "operator" in policy.clear(500 * S)  # nobody has been heard since
    policy.hear_operator(501 * S)
    assert at(policy, 501) == [action]
    assert policy.clear(501 * S) == ""
    assert at(policy, 502, 512) == [GO_ON, action]


def test_an_operator_who_was_never_heard_cannot_be_lost():
    policy = MissionPolicy(MissionSettings(operator_timeout_s=1, on_operator_loss=SURFACE))
    assert at(policy, 1000) == [GO_ON]
    assert list(policy.causes(1000 * S)) == []


def test_going_on_without_the_operator_is_degraded_only():
    policy = armed(operator_timeout_s=10)
    assert at(policy, 11) == [GO_ON]
    assert policy.health(11 * S) == (Health.DEGRADED, "no sign of the operator for 10 s")
    policy.hear_operator(12 * S)
    assert policy.health(12 * S).health is Health.NOMINAL


def test_the_mission_time_begins_with_the_first_arming_and_with_each_new_reference():
    policy = armed(time_limit_s=100, on_time_limit=HOLD)
    policy.disarm()
    policy.arm(50 * S)
    assert at(policy, 100, 101) == [GO_ON, HOLD]
    assert "mission time" in policy.clear(101 * S)
    policy.restart(101 * S)
    assert policy.clear(101 * S) == ""
    assert at(policy, 201, 202) == [GO_ON, HOLD]


@pytest.mark.parametrize("low", [Battery(voltage_V=9.9, remaining=0.9), Battery(voltage_V=12.0, remaining=0.19)])
def test_the_battery_counts_as_low_after_5_s(low):
    policy = armed(battery_min_V=10, battery_min_share=0.2)
    good = Battery(voltage_V=12.0, remaining=0.9)
    for t, battery in enumerate([good, low, low, low, low, good, *6 * [low]]):
        policy.receive(battery, t * S)
        assert at(policy, t) == [SURFACE if t >= 10 else GO_ON]
    assert policy.health(11 * S).health is Health.FAILSAFE


def test_a_battery_that_is_low_from_the_first_message_is_low_at_once():
    policy = armed(battery_min_V=10)
    policy.receive(Battery(voltage_V=9.0), 0)
    assert [cause.name for cause in policy.causes(0)] == ["battery"]


def test_a_leak_surfaces_and_a_stronger_action_replaces_a_weaker_one():
    policy = armed(leak=True, time_limit_s=10, on_time_limit=HOLD)
    policy.receive(Leak(detected=False), 10 * S)
    assert at(policy, 11) == [HOLD]
    policy.receive(Leak(detected=True), 12 * S)
    policy.receive(Leak(detected=False), 13 * S)
    assert at(policy, 13) == [HOLD]  # it was gone before it was looked at
    policy.receive(Leak(detected=True), 14 * S)
    assert at(policy, 14) == [SURFACE]
    policy.receive(Leak(detected=False), 15 * S)
    assert at(policy, 15, 16) == [SURFACE, SURFACE]
    assert policy.health(16 * S) == (Health.FAILSAFE, "surface: leak detected")


@pytest.mark.parametrize("settings", [{"leak": True}, {"battery_min_V": 10}, {"battery_min_share": 0.2}])
def test_silence_of_an_input_is_degraded_and_no_abort(settings):
    policy = armed(**settings)
    assert policy.health(0).health is Health.DEGRADED
    for t in range(3):
        policy.receive(Leak(detected=False), t * S)
        policy.receive(Battery(voltage_V=12.0, remaining=0.9), t * S)
    assert policy.health(7 * S).health is Health.NOMINAL
    assert at(policy, 7.1) == [GO_ON]
    assert policy.health(8 * S) == (
        Health.DEGRADED,
        "leak: no message any more" if "leak" in settings else "battery: no message any more",
    )


def test_a_slow_input_is_silent_after_three_of_its_periods():
    policy = armed(leak=True)
    for t in (0, 10, 20):
        policy.receive(Leak(detected=False), t * S)
    assert policy.health(50 * S).health is Health.NOMINAL
    assert policy.health(51 * S).health is Health.DEGRADED


def test_disarming_ends_an_action_and_what_a_forced_arming_skips_has_none():
    policy = armed(leak=True)
    policy.receive(Leak(detected=True), 0)
    assert at(policy, 1) == [SURFACE]
    policy.disarm()
    assert policy.update(2 * S, armed=False) is GO_ON
    policy.arm(2 * S)
    assert at(policy, 3) == [GO_ON]
    assert policy.health(3 * S) == (Health.DEGRADED, "leak detected")
    policy.receive(Leak(detected=False), 4 * S)
    assert at(policy, 4) == [GO_ON]
    policy.receive(Leak(detected=True), 5 * S)
    assert at(policy, 5) == [SURFACE]


def test_a_skipped_cause_has_no_effect_after_a_restart_until_it_was_gone_once():
    before = armed(leak=True)
    before.receive(Leak(detected=True), 0)
    before.arm(1 * S)
    after = MissionPolicy(MissionSettings(leak=True))
    after.state = before.state
    assert at(after, 2) == [GO_ON]  # no message yet
    after.receive(Leak(detected=True), 3 * S)
    assert at(after, 3) == [GO_ON]
    after.receive(Leak(detected=False), 4 * S)
    assert at(after, 4) == [GO_ON]
    after.receive(Leak(detected=True), 5 * S)
    assert at(after, 5) == [SURFACE]
