"""Source selector: the active source stays, a sound candidate takes over after its silence, no source is banned."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from ltv_mpc.safety.source_selector import (
    MAX_GAP_NS,
    MAX_SILENCE_NS,
    RETURN_NS,
    RUN_MESSAGES,
    RUN_NS,
    Judgement,
    Source,
    SourceSelector,
)

MS = 1_000_000
TRUE, OTHER = Source("default", 1), Source("default", 2)
GNSS = Source("gnss", 3)
GOOD = Judgement(believed=True, consistent=True, agrees=True)
ELSEWHERE = Judgement(believed=True, consistent=True, agrees=False)
BAD = Judgement(believed=False, consistent=False, agrees=False)


def receive(of: SourceSelector, source: Source, t_ns: int, judgement: Judgement = GOOD) -> bool:
    """Pass a message on as ``EstimateSources`` does. Return True if its source is active then."""
    if of.active in (None, source):
        if judgement.believed:
            of.believe(source, t_ns)
        return of.active == source
    return of.offer(source, t_ns, judgement)


def publish(of: SourceSelector, source: Source, times_ms: range, judgement: Judgement = GOOD) -> list[bool]:
    return [receive(of, source, t * MS, judgement) for t in times_ms]


def test_a_second_source_is_reported_while_both_publish_and_not_after_a_restart() -> None:
    of = SourceSelector()
    publish(of, TRUE, range(0, 1000, 100))
    publish(of, OTHER, range(1000, 2000, 100))
    assert of.active == OTHER
    assert of.second(2000 * MS) is None
    publish(of, TRUE, range(2010, 2050, 10))
    publish(of, OTHER, range(2100, 2200, 100))
    assert of.second(2200 * MS) == TRUE
    assert of.second(4000 * MS) is None


def test_a_source_of_another_name_is_no_second_source() -> None:
    of = SourceSelector()
    for t in range(0, 3000, 100):
        publish(of, TRUE, range(t, t + 1))
        publish(of, GNSS, range(t + 50, t + 51))
    assert of.second(3000 * MS) is None
    assert of.rejected == 0


def test_one_disagreement_breaks_a_run() -> None:
    of = SourceSelector()
    publish(of, TRUE, range(0, 1000, 100))
    assert not any(publish(of, OTHER, range(1000, 1400, 100)))
    assert not receive(of, OTHER, 1450 * MS, BAD)
    assert not any(publish(of, OTHER, range(1500, 1900, 100)))


class Sources(RuleBasedStateMachine):
    """Random sources, silences, restarts, names and floods beside one sound source."""

    @initialize(period_ms=st.integers(5, 300), order=st.permutations(("default", "a", "b")))
    def start(self, period_ms: int, order: list[str]) -> None:
        self.of = SourceSelector(order)
        self.order = order
        self.t_ns, self.period_ns, self.epoch, self.name = 0, period_ms * MS, 1000, "default"
        self.sound_since = 0
        self.believed_ns: dict[Source, int] = {}
        self.agreed_since: dict[Source, int] = {}  # of runs without a gap above MAX_GAP_NS
        self.sent_ns: dict[Source, int] = {}
        self.used_ns = 0

    def _send(self, source: Source, judgement: Judgement = GOOD) -> None:
        before, active_ns = self.of.active, self.believed_ns.get(self.of.active or source, 0)
        used = receive(self.of, source, self.t_ns, judgement)
        assert used == (self.of.active == source)  # one active source: the others are rejected
        if judgement != GOOD or self.t_ns - self.sent_ns.get(source, self.t_ns) > MAX_GAP_NS:
            self.agreed_since.pop(source, None)
        self.sent_ns[source] = self.t_ns
        if before not in (None, self.of.active):
            assert judgement.believed
            preferred = self._place(source) < self._place(before)
            long_agreed = self.t_ns - self.agreed_since.get(source, self.t_ns) >= RETURN_NS
            forced = source.name == self.of.forced != before.name
            silent = self.t_ns - active_ns >= 500 * MS and (judgement.agrees or self.t_ns - active_ns > 10_000 * MS)
            assert silent or forced or (preferred and long_agreed)
        if judgement.believed:
            self.believed_ns[source] = self.t_ns
        if judgement == GOOD:
            self.agreed_since.setdefault(source, self.t_ns)
        if used and judgement.believed:
            self.used_ns = self.t_ns

    def _place(self, source: Source) -> int:
        return -1 if source.name == self.of.forced else self.order.index(source.name)

    @rule(
        count=st.integers(1, 30),
        beside=st.integers(0, 5),
        names=st.sampled_from(("default", "a", "b")),
        judgement=st.sampled_from((GOOD, ELSEWHERE, BAD)),
    )
    def publish(self, count: int, beside: int, names: str, judgement: Judgement) -> None:
        """Publish from the sound source, and faster from others beside it."""
        for _ in range(count):
            self.t_ns += self.period_ns
            for other in range(beside):
                self._send(Source(names, other), judgement)
            self._send(Source(self.name, self.epoch))

    @rule(ms=st.integers(0, 20_000))
    def silence(self, ms: int) -> None:
        self.t_ns += ms * MS
        self.sound_since = self.t_ns

    @rule(name=st.sampled_from(("default", "a", "b")))
    def restart(self, name: str) -> None:
        self.epoch, self.name = self.epoch + 1, name
        self.sound_since = self.t_ns

    @rule(count=st.integers(1, 200), epoch=st.integers(0, 400), many=st.booleans(), name=st.sampled_from(("a", "b")))
    def flood(self, count: int, epoch: int, many: bool, name: str) -> None:
        """Another source, or many, send within a moment."""
        for k in range(count):
            self.t_ns += MS // 100
            self._send(Source(name, epoch + (k if many else 0)))

    @rule(name=st.sampled_from(("", "default", "a", "b")))
    def force(self, name: str) -> None:
        self.of.force(name, self.t_ns)

    @invariant()
    def never_without_a_source_for_longer_than_stated(self) -> None:
        sound_ns = self.t_ns - self.sound_since
        limit = max(MAX_SILENCE_NS, RUN_NS, RUN_MESSAGES * self.period_ns) + 2 * self.period_ns + 10 * MS
        if sound_ns > limit:
            assert self.t_ns - self.used_ns <= limit


Sources.TestCase.settings = settings(max_examples=30, stateful_step_count=30, deadline=None)
TestSources = Sources.TestCase
