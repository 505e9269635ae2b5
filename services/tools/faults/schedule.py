"""Fault schedule of `ltv-mpc inject`: a TOML file, or options of the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Injection, MessageFault
from ltv_mpc.validation import bounds
from services.bus.topics import NAMED, topic_at

Time = Annotated[float, Meta(ge=-1e6, le=1e6)]

SHARES = (
    MessageFault.LOSS,
    MessageFault.REORDER,
    MessageFault.DUPLICATE,
    MessageFault.CORRUPTION,
    MessageFault.NOT_A_NUMBER,
)
"""Faults whose size is a share of the messages."""

MAX_DELAY_S = 60.0

WORDS = "HARM,KEY,START_S,END_S[,SIZE[,SEED]]"


class Entry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Entry [[fault]] of a schedule. Times are vehicle times (s)."""

    harm: MessageFault
    key: str
    start_s: Time
    end_s: Time
    size: Annotated[float, Meta(ge=-1e6, le=1e6)] = 1.0
    seed: Annotated[int, Meta(ge=0, le=2**53 - 1)] = 0

    def injection(self, source: str) -> Injection:
        """Convert the entry to the injector's message. Raises ``ConfigError``."""
        injection = Injection(
            key=self.key,
            fault=self.harm,
            start_t_ns=round(self.start_s * 1e9),
            end_t_ns=round(self.end_s * 1e9),
            size=self.size,
            seed=self.seed,
        )
        if (found := problem(injection)) is not None:
            raise ConfigError(source, *found)
        return injection


class Schedule(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Content of a schedule file."""

    fault: tuple[Entry, ...]


def problem(injection: Injection) -> tuple[str, str] | None:
    """Return field and violated bound of an injection that is not possible, or None."""
    topic = topic_at(injection.key)
    if topic is None:
        return "key", "must be a key of `ltv-mpc topics`"
    if topic.message_type in NAMED and injection.key != topic.key:
        return "key", f"must be {topic.key}: a fault there concerns all of its sources"
    if injection.end_t_ns <= injection.start_t_ns:
        return "end_s", f"must be > start_s = {injection.start_t_ns / 1e9:g}"
    if injection.fault in SHARES and not 0 < injection.size <= 1:
        return "size", f"must be > 0 and <= 1 (a share of the messages) for {injection.fault}"
    if injection.fault is MessageFault.DELAY and not 0 < injection.size <= MAX_DELAY_S:
        return "size", f"must be > 0 and <= {MAX_DELAY_S:g} (s) for {injection.fault}"
    # NaN in an array with gaps is a missing value.
    harmable = (isinstance(of.low, float) and not of.has_gaps for of in bounds(topic.message_type).values())
    if injection.fault is MessageFault.NOT_A_NUMBER and not any(harmable):
        return "key", "has no field that can be NaN"
    return None


def load(path: Path) -> list[Injection]:
    """Read a schedule file. Raises ``ConfigError``."""
    source = f"schedule {path}"
    schedule = config.parse(config.read_toml(path, what="schedule"), Schedule, source=source)
    return [entry.injection(f"{source}: [[fault]] {i + 1}") for i, entry in enumerate(schedule.fault)]


def parse(texts: Sequence[str]) -> list[Injection]:
    """Parse faults of the command line: ``HARM,KEY,START_S,END_S[,SIZE[,SEED]]``. Raises ``ConfigError``."""
    names = Entry.__struct_fields__
    injections = []
    for text in texts:
        values = [value.strip() for value in text.split(",")]
        if not 4 <= len(values) <= len(names):
            raise ConfigError("option --fault", "", f"must be {WORDS}", value=text)
        table = {name: config.number_or_text(value) for name, value in zip(names, values, strict=False)}
        injections.append(config.parse(table, Entry, source="option --fault").injection("option --fault"))
    return injections
