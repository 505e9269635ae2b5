"""``ltv-mpc ctl`` against a controller that runs alone, on estimates stamped in Unix time."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import pytest
from msgspec.structs import replace

from ltv_mpc.messages import Authority, ControllerStatus, Estimate, Message, Plan, RunEvent
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import LatestCache, Mailbox
from services.bus.options import BusOptions
from services.bus.session import open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, decode, encode
from services.cli.app import run
from services.processes import operator
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from tests.system.alone import controller
from tests.waiting import PATIENCE_S, until


class Alone(NamedTuple):
    """Controller at a router, with its newest plan."""

    endpoint: str
    newest: LatestCache

    def ctl(self, *words: str) -> int:
        return run(["ctl", *words, "--connect", self.endpoint, "--namespace", "boat"])

    def newest_of(self, kind: type[Message]) -> Any:
        found = self.newest.get(BY_TYPE[kind].key)
        return None if found is None else decode(kind, found.payload)[0]

    def plan(self) -> Any:
        return self.newest_of(Plan)


@contextmanager
def published(endpoint: str, key: str, north_m: float, epoch: int) -> Iterator[None]:
    """Publish an estimate ten times a second under a key."""
    ended = threading.Event()
    with open_session(BusOptions(connect=(endpoint,), namespace="boat"), stop=StopRequest(), say=print) as session:
        put = session.publisher(key).put

        def speak() -> None:
            for sequence in itertools.count():
                estimate = replace(Estimate.at_rest(north_m=north_m, depth_m=0.0), t_ns=time.time_ns())
                put(encode(estimate, Header(epoch=epoch, sequence=sequence)))
                if ended.wait(0.1):
                    return

        speaker = threading.Thread(target=speak)
        speaker.start()
        try:
            yield
        finally:
            ended.set()
            speaker.join()


@pytest.fixture(scope="module")
def without_estimates() -> Iterator[Alone]:
    with controller(loopback.free_port(), ("--reference", "hover", "--namespace", "boat")) as (endpoint, _):
        newest, options = LatestCache(), BusOptions(connect=(endpoint,), namespace="boat")
        with open_session(options, stop=StopRequest(), say=print) as session:
            for kind in (Plan, ControllerStatus):
                session.subscribe(BY_TYPE[kind].key, BY_TYPE[kind], newest)
            yield Alone(endpoint, newest)


@pytest.fixture(scope="module")
def alone(without_estimates: Alone) -> Iterator[Alone]:
    with published(without_estimates.endpoint, "estimate", 1.0, epoch=1):
        until(lambda: without_estimates.newest_of(Plan) is not None)
        yield without_estimates


def test_stop_is_accepted_before_the_first_estimate_and_arm_is_not(without_estimates, capsys) -> None:
    assert without_estimates.plan() is None
    assert without_estimates.ctl("stop") == 0
    assert "command authority: stopped" in capsys.readouterr().out
    assert without_estimates.ctl("arm") == 1
    assert "no estimate received yet" in capsys.readouterr().err
    assert without_estimates.ctl("stop") == 0


def test_a_watch_of_commands_is_accepted_or_refused_as_the_plan_says(alone, tmp_path, capsys) -> None:
    assert alone.ctl("stop") == 0
    until(lambda: alone.plan().authority is Authority.STOPPED)
    assert alone.ctl("arm") == alone.ctl("disarm") == 0
    until(lambda: alone.plan().authority is Authority.DISARMED)
    capsys.readouterr()
    point = tmp_path / "there.toml"
    point.write_text('kind = "point"\nnorth_m = 2.5\neast_m = -1.0\n')
    watch = [
        (("manual",), 1, "send `arm` first", "disarmed"),
        (("arm",), 0, "command authority: controller", "controller"),
        (("follow", str(point)), 0, "accepted", "controller"),
        (("manual",), 0, "command authority: manual", "manual"),
        (("release",), 0, "command authority: controller", "controller"),
        (("hold",), 0, "accepted", "controller"),
        (("clear",), 0, "accepted", "controller"),
        (("stop",), 0, "command authority: stopped", "stopped"),
        (("release",), 1, "no pilot", "stopped"),
        (("arm",), 0, "command authority: controller", "controller"),
        (("disarm",), 0, "command authority: disarmed", "disarmed"),
    ]
    wanted = {"follow": (2.5, -1.0), "hold": pytest.approx((1.0, 0.0), abs=0.01)}
    for words, code, said, authority in watch:
        assert alone.ctl(*words) == code, words
        shown = capsys.readouterr()
        assert said in (shown.err if code else shown.out)
        until(lambda authority=authority: alone.plan().authority == authority)
        if words[0] in wanted:
            until(lambda there=wanted[words[0]]: alone.plan().reference_m == there)
    now_ns = time.time_ns()
    assert abs(alone.plan().cycle_t_ns - now_ns) < 10_000_000_000  # its knots are in the other side's time


BUOY = {
    "fence.toml": """margin_m = 2.0
keep_out_disc = [{ name = "buoy", centre = { north_m = 51.0, east_m = 0.0 }, radius_m = 3.0 }]
""",
    "fence.geojson": """{"type": "FeatureCollection", "margin_m": 2.0,
"origin": {"latitude_deg": 50.0, "longitude_deg": -5.0},
"features": [{"type": "Feature", "properties": {"zone": "keep_out_disc", "name": "buoy", "radius_m": 3.0},
"geometry": {"type": "Point", "coordinates": [-5.0, 50.0004585]}}]}
""",
}


@pytest.mark.parametrize("name", BUOY)
def test_a_fence_is_in_force_until_another_one_or_none_is_sent(alone, tmp_path, capsys, name) -> None:
    (tmp_path / name).write_text(BUOY[name])
    assert alone.ctl("fence", str(tmp_path / name)) == 0
    assert "accepted" in capsys.readouterr().out
    until(lambda: alone.plan().fence is not None)
    assert alone.plan().fence.nearest == 'keep_out_disc[0] "buoy"'
    assert alone.plan().fence.clearance_m == pytest.approx(50.0 - 3.0 - Vehicle.load("paper").hull.radius_m, abs=1.0)
    (tmp_path / "broken.toml").write_text("margin_m = 2.0\n")
    assert alone.ctl("fence", str(tmp_path / "broken.toml")) == 2
    assert "no zone" in capsys.readouterr().err
    after = alone.plan().cycle_t_ns
    until(lambda: alone.plan().cycle_t_ns > after)
    assert alone.plan().fence.nearest == 'keep_out_disc[0] "buoy"'
    assert alone.ctl("fence", "none") == 0
    until(lambda: alone.plan().fence is None)


def test_arm_is_refused_by_a_pre_arm_check_and_forced_with_what_it_skips(alone, tmp_path, capsys) -> None:
    far = tmp_path / "far.toml"
    far.write_text('kind = "point"\nnorth_m = 9000.0\neast_m = 0.0\n')
    assert alone.ctl("stop") == alone.ctl("follow", str(far)) == 0
    assert alone.ctl("arm") == 1
    assert "reference: its start is 8999 m away, more than 2000 m" in capsys.readouterr().err
    assert alone.ctl("arm", "--force") == 0
    shown = capsys.readouterr()
    assert "command authority: controller" in shown.out
    assert "skipped: reference: its start is 8999 m away" in shown.err
    assert alone.ctl("follow", "hover") == alone.ctl("disarm") == 0


def test_another_source_is_used_when_it_is_named_and_both_are_in_the_status(alone, capsys) -> None:
    """The other one, 40 m away, publishes on a key of its own."""
    assert alone.ctl("source", "gnss") == 1
    assert "no valid message of source gnss in the last 10 s; sources: default" in capsys.readouterr().err
    events = Mailbox()
    options = BusOptions(connect=(alone.endpoint,), namespace="boat")

    def source() -> str:
        status = alone.newest_of(ControllerStatus)
        return "" if status is None else str(status.source)

    with (
        open_session(options, stop=StopRequest(), say=print) as session,
        published(alone.endpoint, "estimate/gnss", 41.0, epoch=2),
    ):
        session.subscribe("event/controller", BY_TYPE[RunEvent], events)
        until(lambda: source() == "default")
        until(lambda: alone.ctl("source", "gnss") == 0)
        until(lambda: source() == "gnss")
        frame = events.take(PATIENCE_S)
        assert frame is not None
        text = decode(RunEvent, frame.payload)[0].text
        assert text == "source of the estimates: default, epoch 1 -> gnss, epoch 2"
        assert alone.ctl("source", "default") == 0
        until(lambda: source() == "default")
        assert alone.ctl("source") == 0


def test_where_nobody_answers_it_says_so_and_exits_1(alone, capsys, monkeypatch) -> None:
    assert run(["ctl", "arm", "--connect", alone.endpoint, "--namespace", "nobody"]) == 1
    assert "no reply from a controller within 3 s" in capsys.readouterr().err
    monkeypatch.setattr(operator, "TIMEOUT_S", 1.0)
    assert run(["ctl", "arm", "--connect", f"tcp/127.0.0.1:{loopback.free_port()}"]) == 1
    assert "no router within 1 s" in capsys.readouterr().err
