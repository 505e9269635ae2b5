"""Source selector: the active source stays, a sound candidate takes over after its silence, no source is banned."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from ltv_mpc.safety.source_selector import MAX_SILENCE_NS, RUN_MESSAGES, RUN_NS, SourceSelector

MS = 1_000_000
TRUE, OTHER = 1, 2


def publish(of: SourceSelector, source: int, times_ms: range, *, agrees: bool = True) -> list[bool]:
    return [of.receive(source, t * MS, believed=True, agrees=agrees) for t in times_ms]


def test_one_message_of_another_source_changes_nothing() -> None:
    of = SourceSelector()
    publish(of, TRUE, range(0, 1000, 100))
    assert not of.receive(OTHER, 950 * MS, believed=True, agrees=True)
    assert all(publish(of, TRUE, range(1000, 3000, 100)))
    assert (of.active, of.second, of.rejected) == (TRUE, OTHER, 1)


def test_a_second_source_is_reported_while_both_publish_and_not_after_a_restart() -> None:
    of = SourceSelector()
    publish(of, TRUE, range(0, 1000, 100))
    publish(of, OTHER, range(1000, 2000, 100))
    assert of.active == OTHER
    assert not of.contested(2000 * MS)
    publish(of, TRUE, range(2010, 2050, 10))
    publish(of, OTHER, range(2100, 2200, 100))
    assert of.contested(2200 * MS)
    assert not of.contested(4000 * MS)


def test_a_restarted_source_is_back_within_its_silence_and_five_messages() -> None:
    for period_ms, limit_ms in ((10, 600), (100, 600), (300, 1500)):
        of = SourceSelector()
        publish(of, TRUE, range(0, 3000 + 1, period_ms))
        first = next(
            t
            for t in range(3000 + period_ms, 10_000, period_ms)
            if of.receive(OTHER, t * MS, believed=True, agrees=True)
        )
        assert first - 3000 <= limit_ms


def test_a_former_source_takes_over_again() -> None:
    of = SourceSelector()
    for k, source in enumerate((TRUE, OTHER, TRUE, OTHER)):
        publish(of, source, range(2000 * k, 2000 * k + 1500, 100))
        assert of.active == source


def test_a_source_that_disagrees_never_takes_over_and_one_disagreement_breaks_a_run() -> None:
    of = SourceSelector()
    publish(of, TRUE, range(0, 1000, 100))
    assert not any(publish(of, OTHER, range(1000, 9000, 100), agrees=False))
    assert not any(publish(of, OTHER, range(9000, 9400, 100)))
    assert not of.receive(OTHER, 9450 * MS, believed=False, agrees=True)
    assert not any(publish(of, OTHER, range(9500, 9900, 100)))


class Sources(RuleBasedStateMachine):
    """Random sources, silences, restarts and floods beside one sound source."""

    @initialize(period_ms=st.integers(5, 300))
    def start(self, period_ms: int) -> None:
        self.of = SourceSelector()
        self.t_ns, self.period_ns, self.sound = 0, period_ms * MS, 1000
        self.sound_since = 0
        self.last_active_believed = 0

    def _send(self, source: int, *, believed: bool = True, agrees: bool = True) -> None:
        before, silent = self.of.active, self.of.silent_ns(self.t_ns)
        used = self.of.receive(source, self.t_ns, believed=believed, agrees=agrees)
        assert used == (self.of.active == source)
        if before is not None and self.of.active != before:  # no takeover from a source that is believed
            assert silent is not None
            assert silent >= 500 * MS
            assert believed
            assert agrees
        if used and believed:
            self.last_active_believed = self.t_ns

    @rule(count=st.integers(1, 30), beside=st.integers(0, 5), believed=st.booleans(), agrees=st.booleans())
    def publish(self, count: int, beside: int, believed: bool, agrees: bool) -> None:
        """Publish from the sound source, and faster from others beside it."""
        for _ in range(count):
            self.t_ns += self.period_ns
            for other in range(beside):
                self._send(other, believed=believed, agrees=agrees)
            self._send(self.sound)

    @rule(ms=st.integers(0, 20_000))
    def silence(self, ms: int) -> None:
        self.t_ns += ms * MS
        self.sound_since = self.t_ns

    @rule()
    def restart(self) -> None:
        self.sound += 1
        self.sound_since = self.t_ns

    @rule(count=st.integers(1, 200), source=st.integers(0, 400), many=st.booleans())
    def flood(self, count: int, source: int, many: bool) -> None:
        """Another source, or many, send within a moment."""
        for k in range(count):
            self.t_ns += MS // 100
            self._send(source + (k if many else 0))

    @invariant()
    def never_without_a_source_for_longer_than_stated(self) -> None:
        if not hasattr(self, "of"):
            return
        sound_ns = self.t_ns - self.sound_since
        limit = max(MAX_SILENCE_NS, RUN_NS, RUN_MESSAGES * self.period_ns) + 2 * self.period_ns + 10 * MS
        if sound_ns > limit:
            assert self.t_ns - self.last_active_believed <= limit


Sources.TestCase.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)
TestSources = Sources.TestCase
