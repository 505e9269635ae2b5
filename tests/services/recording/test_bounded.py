"""Loss accounting with any number of sources: memory is bounded, and no loss is forgotten."""

from __future__ import annotations

from services.bus.sequence_check import MAX_FIRST
from services.recording.loss_accounting import MAX_PROCESSES, LossAccounting, SequenceGaps


def test_losses_are_the_gaps_of_each_key_and_epoch_and_of_a_late_recorder_those_from_its_first_message_on() -> None:
    of = LossAccounting(late=True)
    for key, epoch, sequence in (
        *(("estimate", 7, 5), ("estimate", 7, 7), ("plan", 7, 3)),
        *(("plan", 5, 0), ("plan", 5, 4), ("applied", 5, 1), ("plan", 6, 0), ("plan", 6, 0)),  # starts, and a duplicate
    ):
        of.add(key, epoch, sequence)
    assert (of.published, of.missing) == (3 + 1 + 5 + 2 + 1, 1 + 3 + 1)
    assert of.by_key() == {"estimate": 1, "plan": 3, "applied": 1}
    assert [of.begins_late(key, 7) for key in ("estimate", "plan", "applied")] == [False, True, False]
    assert not of.begins_late("plan", 6)
    assert of.fill("plan", 5, 2)
    assert of.missing == 4


def test_a_first_message_far_from_number_0_is_of_a_sender_that_began_elsewhere() -> None:
    of = LossAccounting()
    of.add("plan", 1, MAX_FIRST)
    of.add("plan", 2, MAX_FIRST + 1)
    assert of.by_key() == {"plan": MAX_FIRST}


def test_losses_of_dropped_sources_stay_counted() -> None:
    of = LossAccounting(max_sources=10)
    for epoch in range(1000):
        of.add("plan", epoch, 0)
        of.add("plan", epoch, 3)  # two are missing
        of.add("applied", 7, epoch)  # never silent
    assert len(of._sources) == 10
    assert (of.published, of.missing) == (4 * 1000 + 1000, 2 * 1000)
    assert of.by_key() == {"others": 2 * 991, "plan": 2 * 9}
    of.add("plan", 0, 500)  # counted from this message on
    of.add("plan", 0, 502)
    assert of.missing == 2001


def test_the_oldest_of_very_many_gaps_count_as_lost() -> None:
    of = SequenceGaps(max_gaps=3)
    for sequence in range(0, 20, 2):
        assert of.add(sequence)
    assert (of.missing, of.ranges) == (9, ((13, 13), (15, 15), (17, 17)))
    assert of.add(17)
    assert not of.add(1)  # known no more: it might be there already
    assert (of.missing, of.doubled) == (8, 1)


def test_what_a_process_says_it_has_published_shows_what_is_missing() -> None:
    of = LossAccounting()
    for key, sequence in (("plan", 0), ("plan", 0), ("status/controller", 0), ("plan", 3), ("plan", 4)):
        of.add(key, 7, sequence)
    assert of.unfinished(0)
    assert not of.unfinished(7)
    of.set_published(7, "controller", 7)
    of.set_published(7, "controller", 2**50)
    assert not of.unfinished(0)
    assert of.by_process() == {"controller": 3}
    of.fill("plan", 7, 1)  # refused when it came: it is recorded
    of.fill("plan", 7, 5)
    of.add("plan", 7, 6)
    assert of.by_process() == {}


def test_a_process_that_published_before_counting_misses_nothing() -> None:
    of = LossAccounting(late=True)
    for epoch, sequence in ((1, 3), (1, 4), (2, 0), (2, 5)):  # only the first one tells
        of.add("applied", epoch, sequence)
    of.set_published(1, "plant", 900)
    of.set_published(2, "sensors", 3)
    assert of.by_process() == {"sensors": 1}


def test_only_the_process_that_is_silent_longest_is_forgotten() -> None:
    of = LossAccounting()
    of.add("plan", 7, 0)
    of.set_published(7, "controller", 2)
    for epoch in range(1000, 1000 + 2 * MAX_PROCESSES):
        of.add("plan", epoch, 0)
        of.add("plan", 7, 0)
    assert len(of._processes) == MAX_PROCESSES
    assert of.by_process() == {"controller": 1}
