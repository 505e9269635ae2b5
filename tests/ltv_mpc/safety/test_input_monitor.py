"""Input monitor: order, source, period, alive, valid, rate."""

from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.safety.input_age import CLOCK_SET_BACK_NS, InputAge, InputMonitor

MS = 1_000_000


def received(*stamps_ms: float, epoch: int = 7, delay_ms: float = 0.0) -> InputMonitor:
    of = InputMonitor()
    for k, t in enumerate(stamps_ms):
        assert of.receive(epoch=epoch, sequence=k, stamp_ns=round(t * MS), received_ns=round((t + delay_ms) * MS))
    return of


def flags(of: InputMonitor, t_ns: int) -> tuple[bool, bool, bool]:
    report = of.report("estimate", t_ns)
    return report.alive, report.valid, report.rate


def test_the_period_is_the_median_spacing_despite_losses_and_bursts():
    age = InputAge()
    assert age.median_ns == 0
    for t_ms in (0, 200, 400, 600, 1400, 1401, 1402, 1600, 1800, 2000):
        age.add(t_ms * MS)
    assert age.median_ns == 200 * MS
    for t_ms in range(2020, 2200, 20):
        age.add(t_ms * MS)
    assert age.median_ns == 20 * MS


def test_before_the_first_message_every_flag_is_false():
    assert flags(InputMonitor(), 0) == (False, False, False)
    assert (InputMonitor().report("estimate", 0).age_ns, InputMonitor().report("estimate", 0).period_ns) == (None, 0)


def test_alive_is_by_arrival_and_valid_by_stamp():
    late = received(*range(0, 1000, 100), delay_ms=700)  # each 0.7 s old when it comes
    assert flags(late, 1650 * MS) == (True, False, True)
    assert flags(late, 2200 * MS) == (False, False, True)
    assert late.age.silent_ns(1650 * MS) == 50 * MS
    prompt = received(*range(0, 1000, 100))
    assert flags(prompt, 1400 * MS) == (True, True, True)
    assert flags(prompt, 1400 * MS + 1) == (False, False, True)
    assert prompt.report("estimate", 950 * MS).age_ns == 50 * MS


def test_a_message_that_is_stamped_ahead_of_time_is_not_valid():
    ahead = received(*range(0, 1000, 100), delay_ms=-800)
    assert flags(ahead, 100 * MS) == (True, False, True)


def test_a_stamp_that_another_source_repeats_does_not_shorten_the_period():
    of = received(0, 100, 200)
    for epoch in range(8, 11):
        assert of.receive(epoch=epoch, sequence=0, stamp_ns=200 * MS, received_ns=210 * MS)
    assert of.report("estimate", 300 * MS).period_ns == 100 * MS


def test_the_rate_is_false_if_more_than_half_of_the_messages_are_missing():
    assert received(0, 100, 200, 300, 400, 500, 900).report("estimate", 900 * MS).rate
    assert not received(0, 100, 200, 300, 400, 500, 2000).report("estimate", 2000 * MS).rate


def test_repeated_and_older_messages_are_rejected_and_counted():
    of = received(0, 100, 200)
    before = msgspec.structs.replace(of.report("estimate", 300 * MS), rejected=4)
    assert not of.receive(epoch=7, sequence=2, stamp_ns=200 * MS, received_ns=210 * MS)
    assert not of.receive(epoch=7, sequence=1, stamp_ns=300 * MS, received_ns=300 * MS)
    assert not of.receive(epoch=7, sequence=3, stamp_ns=150 * MS, received_ns=300 * MS)
    assert not of.receive(epoch=9, sequence=0, stamp_ns=150 * MS, received_ns=300 * MS)
    assert of.rejected == 4
    assert of.report("estimate", 300 * MS) == before


def test_a_restarted_source_continues_and_one_with_its_clock_set_back_restarts():
    of = received(0, 100, 200)
    assert of.receive(epoch=9, sequence=0, stamp_ns=900 * MS, received_ns=900 * MS)
    assert not of.receive(epoch=9, sequence=0, stamp_ns=1000 * MS, received_ns=1000 * MS)
    assert of.receive(epoch=9, sequence=1, stamp_ns=900 * MS - CLOCK_SET_BACK_NS - 1, received_ns=1000 * MS)
    assert of.report("estimate", 1000 * MS).period_ns == 0


def test_a_clock_that_jumps_ahead_and_returns_has_no_lasting_effect():
    """A jump by 5 s is below the limit of a clock that was set back; 200 s is above it."""
    for jump_ms in (1_001, 5_000, 200_000):
        of = received(0, 100, 200)
        assert not of.receive(epoch=7, sequence=3, stamp_ns=(300 + jump_ms) * MS, received_ns=300 * MS)
        assert of.rejected == 1
        assert of.receive(epoch=7, sequence=4, stamp_ns=400 * MS, received_ns=400 * MS)
        assert of.report("estimate", 400 * MS).valid
        assert of.age.silent_ns(450 * MS) == 50 * MS


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0, 9), st.integers(0, 2000)), max_size=30))
def test_accepted_messages_of_one_source_have_increasing_sequences_and_stamps(messages):
    of, last = InputMonitor(), {}
    newest = -1
    for epoch, sequence, stamp_ms in messages:
        if of.receive(epoch=epoch, sequence=sequence, stamp_ns=stamp_ms * MS, received_ns=2000 * MS):
            if last and last["epoch"] == epoch:
                assert sequence > last["sequence"]
            assert stamp_ms >= newest
            newest, last = stamp_ms, {"epoch": epoch, "sequence": sequence}
