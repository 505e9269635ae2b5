"""Loss accounting with any number of sources: memory is bounded, and no loss is forgotten."""

from __future__ import annotations

from services.recording import publish_counts
from services.recording.loss_accounting import LossAccounting
from services.recording.publish_counts import PublishCounts
from services.recording.sequence_gaps import SequenceGaps


def accounting() -> LossAccounting:
    return LossAccounting(max_sources=10)


def test_losses_are_the_gaps_of_each_key_and_epoch_and_of_a_late_recorder_those_from_its_first_message_on() -> None:
    of = accounting()
    of.start_at("estimate", 7, 500)
    of.add("estimate", 7, 500)
    of.start_at("estimate", 7, 502)  # it has begun already
    of.add("estimate", 7, 502)
    for epoch, sequence in ((5, 1), (5, 4), (6, 0), (6, 0)):  # another start of its source, and a duplicate
        of.add("plan", epoch, sequence)
    assert (of.published, of.missing) == (3 + 5 + 1, 1 + 3)
    assert of.by_key() == {"estimate": 1, "plan": 3}
    of.mark_lost("estimate", 7)
    assert of.missing == 5
    assert of.fill("plan", 5, 2)
    assert of.missing == 4


def test_losses_of_dropped_sources_stay_counted() -> None:
    of = accounting()
    for epoch in range(1000):
        of.add("plan", epoch, 0)
        of.add("plan", epoch, 3)  # two are missing
        of.add("applied", 7, epoch)  # never silent
    assert len(of._sources) == 10
    assert (of.published, of.missing) == (4 * 1000 + 1000, 2 * 1000)
    assert of.by_key() == {"others": 2 * 991, "plan": 2 * 9}
    of.mark_lost("plan", 0)
    of.mark_lost("plan", 999)
    assert of.missing == 2002
    of.add("plan", 0, 500)  # counted from this message on
    of.add("plan", 0, 502)
    assert of.missing == 2003


def test_the_oldest_of_very_many_gaps_count_as_lost() -> None:
    of = SequenceGaps(max_gaps=3)
    for sequence in range(0, 20, 2):
        assert of.add(sequence)
    assert (of.missing, of.ranges) == (9, ((13, 13), (15, 15), (17, 17)))
    assert of.add(17)
    assert not of.add(1)  # known no more: it might be there already
    assert (of.missing, of.doubled) == (8, 1)


def test_what_a_process_says_it_has_published_shows_what_is_missing() -> None:
    of = PublishCounts()
    for again in (False, True, False):
        of.count(7)
        if again:
            of.discount(7)
    assert of.unfinished(0)
    assert not of.unfinished(7)
    of.set_published(7, "controller", 3)
    of.set_published(7, "controller", 2**50)
    assert not of.unfinished(0)
    assert of.missing == {"controller": 1}


def test_a_process_that_published_before_counting_misses_nothing() -> None:
    of = PublishCounts()
    assert not of.count(1, late=True)
    assert not of.count(1)
    assert of.count(2)
    assert of.count(2, late=True)  # only the first one tells
    of.set_published(1, "plant", 900)
    of.set_published(2, "sensors", 2)
    assert of.missing == {}
    of.discount(2)
    of.discount(1)
    assert of.missing == {"sensors": 1}


def test_only_the_process_that_is_silent_longest_is_forgotten() -> None:
    of = PublishCounts()
    of.count(7)
    of.set_published(7, "controller", 2)
    for epoch in range(1000, 1000 + 2 * publish_counts.MAX_EPOCHS):
        of.count(epoch)
        of.count(7)
        of.discount(7)
    assert len(of._counts) == publish_counts.MAX_EPOCHS
    assert of.missing == {"controller": 1}
