"""Ablation study: what it switches off, and its statistics of paired runs."""

import math

import numpy as np
import pytest

from benchmarks.ablation import runner
from benchmarks.ablation.mechanism import Event, Mechanism, replaced


class Owner:
    value = 1


def test_a_replaced_name_is_back_afterwards_and_one_that_is_not_there_is_refused():
    with replaced((Owner, "value", 2)):
        assert Owner.value == 2
    assert Owner.value == 1
    with pytest.raises(AttributeError), replaced((Owner, "nothing", 2)):
        pass


def test_the_effect_is_that_of_the_pairs_and_a_pair_without_a_number_does_not_count():
    effect = runner.effect("m", np.array([[1.0, 2.0], [3.0, 5.0], [5.0, 6.0], [math.nan, 100.0]]))
    assert effect.pairs == 3
    assert (effect.with_it, effect.without, effect.worst_without) == (3.0, pytest.approx(13 / 3), 6.0)
    assert effect.difference == pytest.approx(4 / 3)
    assert effect.detectable == pytest.approx(2.8 * np.std([1, 2, 1], ddof=1) / math.sqrt(3))


def test_the_baseline_of_an_event_is_run_once_for_all_mechanisms():
    event = Event("event", "in words", lambda seed: {"m": float(seed)})
    mechanisms = [Mechanism(name, event, replaced, ("m",)) for name in ("a", "b")]
    todo = runner.jobs(mechanisms, range(2), set())
    assert len(todo) == 6
    known = {key for job in todo[:-1] for key in job.keys}
    assert [job.keys for job in runner.jobs(mechanisms, range(2), known)] == [todo[-1].keys]


def test_every_row_is_unique_and_its_switch_fits_the_code():
    assert len({(m.name, m.event.name) for m in runner.MECHANISMS}) == len(runner.MECHANISMS)
    for mechanism in runner.MECHANISMS:
        with mechanism.off():
            pass
