"""Foreign publishers: other encodings and other clocks replay as they were understood live."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest

from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Action, Command, Estimate, InboxEntry, Message, RecordedStep, StepRecord
from ltv_mpc.node import ReceivedMessage
from services.bus import wire
from services.bus.time_shift import shifted
from services.bus.topics import key_of, source_of
from services.recording.reader import Recording
from services.recording.writer import RunWriter
from services.replay import nodes
from services.replay import replay as engine
from services.replay.node_replay import received_message
from tests.services.bus.messages import EXAMPLES

HEADER = wire.Header(epoch=77, sequence=3, sent_monotonic_us=5)


def backwards(value: Any) -> Any:
    """Reverse the order of every map's fields."""
    if isinstance(value, dict):
        return {name: backwards(value[name]) for name in reversed(value)}
    return [backwards(x) for x in value] if isinstance(value, list) else value


def shortest(value: Any) -> Any:
    """Encode 1.0 as 1, as JavaScript does."""
    if isinstance(value, dict):
        return {name: shortest(x) for name, x in value.items()}
    if isinstance(value, list):
        return [shortest(x) for x in value]
    return int(value) if isinstance(value, float) and value.is_integer() and value != 0.0 else value


SPELLINGS: tuple[Callable[[Any], bytes], ...] = (
    lambda plain: msgpack.packb(backwards(plain)),
    lambda plain: msgpack.packb(shortest(plain)),
    lambda plain: msgpack.packb(plain, use_single_float=True),
)


@pytest.mark.parametrize("signal", EXAMPLES, ids=lambda signal: type(signal).__name__)
def test_a_frame_is_found_by_its_checksum_and_decoded_as_it_was_live(signal: Message, tmp_path: Path) -> None:
    kind, plain = type(signal), wire.to_map(signal, HEADER) if not isinstance(signal, StepRecord) else None
    if plain is None:  # its epoch is its sender's
        plain = wire.to_map(signal, msgspec.structs.replace(HEADER, epoch=signal.epoch))  # type: ignore[attr-defined]
    for i, spell in enumerate(SPELLINGS):
        payload = spell(plain)
        try:
            live, header = wire.decode(kind, payload)
        except wire.WireError:  # 32 bits are too few for it: what is refused is in no inbox
            assert spell is SPELLINGS[2]
            continue
        key, path = key_of(kind, "controller"), tmp_path / f"{i}.mcap"
        with RunWriter(path, start_ns=0, metadata={}) as writer:
            writer.write_plain(key, kind, wire.unpack(payload), 0, wire.crc(payload))
        (stored,) = Recording(path)
        assert stored.crc == wire.crc(payload)
        entry = InboxEntry(key=key, epoch=header.epoch, sequence=3, crc=stored.crc, received_t_ns=9)
        again = received_message(stored, entry)
        assert (again.epoch, again.sequence, again.received_t_ns) == (header.epoch, 3, 9)
        assert wire.encode(again.message, header) == wire.encode(live, header)


@pytest.mark.parametrize(("set_by_ns", "source"), [(-5_000_000_000, ""), (0, "gnss")])
def test_a_controller_on_a_foreign_clock_replays_by_its_recorded_times(recording, tmp_path, set_by_ns, source) -> None:
    """Foreign estimates in nanoseconds since 1970, integral floats encoded as integers; no plant, no sensors.

    In mid-run the foreign clock is set. Vehicle time runs on. Or the estimates are those of a source with a name.
    """
    run = engine.Run(recording)
    run_config = nodes.run_config_of(run.metadata, source="")
    node = ControllerNode(run_config.vehicle, run_config.reference, run_config.scenario.controller)
    began, own, theirs = 1_763_000_000_123_456_789, 5, 6
    path = tmp_path / "run.mcap"
    metadata = {name: text for name, text in run.metadata.items() if name != "start_ns"}
    sequences: dict[str, int] = {}
    made = 0

    def numbered(key: str) -> int:
        sequences[key] = sequences.get(key, -1) + 1
        return sequences[key]

    with RunWriter(path, start_ns=began, metadata=metadata) as writer:
        for step in range(12):
            t_ns, shift_ns = began + step * run_config.scenario.controller.period_ns, set_by_ns * (step >= 6)
            stamp_ns = t_ns - 7_000_001 + shift_ns
            heard: list[Message] = [
                msgspec.structs.replace(Estimate.at_rest(north_m=0.5 * step, heading_rad=1.0), t_ns=stamp_ns)
            ]
            heard += [Command(command_id=1, action=Action.ARM)] if step == 0 else []
            arrivals, entries = [], []
            for signal in heard:
                key = key_of(type(signal), "")
                if source and isinstance(signal, Estimate):
                    key = f"{key}/{source}"
                payload = SPELLINGS[1](wire.to_map(signal, wire.Header(epoch=theirs, sequence=numbered(key))))
                understood, header = wire.decode(type(signal), payload)
                understood, named = shifted(understood, -shift_ns), _named(header)
                arrivals.append(ReceivedMessage(understood, header.epoch, header.sequence, t_ns, source_of(key)))
                entries.append(
                    InboxEntry(key=key, crc=wire.crc(payload), received_t_ns=t_ns, shift_ns=-shift_ns, **named)
                )
                writer.write_plain(key, type(signal), wire.unpack(payload), t_ns, wire.crc(payload))
            record = StepRecord(
                node=node.name,
                epoch=own,
                step=step,
                steps=(RecordedStep(t_ns=t_ns, cause="cycle", inbox=tuple(entries), shift_ns=shift_ns),),
            )
            outputs = node.step(t_ns, arrivals)
            made += len(outputs)
            for signal in (record, *(shifted(output, shift_ns) for output in outputs)):
                key = key_of(type(signal), node.name)
                writer.write(node.name, signal, wire.Header(epoch=own, sequence=numbered(key)), t_ns)
    verdict = engine.replay(engine.Run(path))
    assert verdict.identical
    (controller,) = [of for of in verdict.nodes if of.steps_run]
    assert (controller.node, controller.steps_run, controller.steps_compared) == ("controller", 12, 12)
    assert controller.outputs_compared == made >= 13
    assert verdict.vehicle_s == pytest.approx(11 * 0.3)
    plans = [message.plain for message in Recording(path) if message.key == "plan"]
    assert plans[-1]["cycle_t_ns"] == began + 11 * run_config.scenario.controller.period_ns + set_by_ns
    assert np.abs(plans[-1]["thrust_N"]).max() > 1.0


def _named(header: wire.Header) -> dict[str, int]:
    return {"epoch": header.epoch, "sequence": header.sequence}
