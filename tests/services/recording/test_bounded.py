"""Loss accounting with any number of sources: memory is bounded, and no loss is forgotten."""

from __future__ import annotations

from services.recording.loss_accounting import LossAccounting
from services.recording.publish_counts import PublishCounts
from services.recording.sequence_gaps import SequenceGaps


def accounting() -> LossAccounting:
    return LossAccounting(max_sources=10)


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


def test_a_dropped_source_counts_from_its_next_message() -> None:
    of = accounting()
    for epoch in range(20):
        of.add("plan", epoch, 0)
    of.add("plan", 0, 500)
    of.add("plan", 0, 502)
    assert of.missing == 1


def test_keys_beyond_the_limit_share_one_sum() -> None:
    of = accounting()
    for k in range(100):
        of.add(f"status/{k}", 1, 0)
        of.add(f"status/{k}", 1, 2)  # one is missing
    assert len(of._sources) == 10
    assert (of.missing, sum(of.by_key().values())) == (100, 100)


def test_the_oldest_of_very_many_gaps_count_as_lost() -> None:
    of = SequenceGaps(max_gaps=3)
    for sequence in range(0, 20, 2):
        assert of.add(sequence)
    assert (of.missing, of.ranges) == (9, ((13, 13), (15, 15), (17, 17)))
    assert of.add(17)
    assert not of.add(1)  # known no more: it might be there already
    assert (of.missing, of.doubled) == (8, 1)


def test_duplicates_do_not_replace_missing_messages() -> None:
    of = accounting()
    assert [of.add("plan", 7, sequence) for sequence in (0, 3, 3, 1, 1, 0)] == [True, True, False, True, False, False]
    assert (of.published, of.missing, of.by_key()) == (4, 1, {"plan": 1})
    kept = PublishCounts(max_epochs=10)
    for again in (False, True, False):
        kept.count(7)
        if again:
            kept.discount(7)
    kept.set_published(7, "controller", 3)
    assert kept.missing == {"controller": 1}


def test_missing_messages_of_closed_accounts_stay_counted() -> None:
    of = PublishCounts(max_epochs=10)
    for epoch in range(1000):
        of.count(epoch)
        of.set_published(epoch, f"node {epoch % 2}", 3)  # two are missing
        of.count(5000)
    assert len(of._accounts) == 10
    assert of.missing == {"node 0": 1000, "node 1": 1000}
    assert of.unfinished(0)
    assert not of.unfinished(5000)


def test_a_process_that_published_before_counting_misses_nothing() -> None:
    of = PublishCounts(max_epochs=10)
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
