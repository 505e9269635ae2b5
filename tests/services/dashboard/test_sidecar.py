"""Live page of a run: its address is printed, and a failure of the page does not affect the run."""

from __future__ import annotations

import json
import os
import threading
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.sync.client import connect

from services.bus.options import BusOptions
from services.bus.session import open_session
from services.dashboard.config import About, Config
from services.dashboard.serve import NICE
from services.dashboard.sidecar import Sidecar
from services.recording.node_settings import VEHICLE as VEHICLE_FILE
from tests.services.reporting import synthetic_run
from tests.waiting import until


def page_of(folder: Path, *, waits: bool = True) -> tuple[Sidecar, list[str]]:
    said: list[str] = []
    (folder / "logs").mkdir()
    vehicle = folder / VEHICLE_FILE
    vehicle.parent.mkdir()
    vehicle.write_text(synthetic_run.VEHICLE)
    config = Config(vehicle=str(vehicle), about=About(report=str(folder / "report.html")), of_a_run=True)
    return Sidecar(said.append, folder / "logs", config, waits=waits), said


def gives_way(pid: int) -> None:
    """Check the low priority of the process, within its session and against other sessions."""
    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert os.getpriority(os.PRIO_PROCESS, pid) == min(own + NICE, 19)  # Linux has none lower
    if (group := Path(f"/proc/{pid}/autogroup")).exists():
        assert group.read_text().split()[-2:] == ["nice", str(NICE)]


@pytest.mark.parametrize("waits", [True, False])
def test_the_run_waits_for_a_page_from_opened_to_drawn_and_then_until_it_has_the_report(tmp_path, free_port, waits):
    endpoint = f"tcp/127.0.0.1:{free_port}"
    page, said = page_of(tmp_path, waits=waits)
    with open_session(BusOptions(listen=(endpoint,)), stop=lambda: False, say=said.append):
        page.start(BusOptions(connect=(endpoint,), namespace="a/run"))
        given = threading.Thread(target=page.give_report)
        try:
            page.show("compiling: 43 %")
            until(lambda: said, within_s=60.0)
            page.give_report()  # nobody shows the page
            url = urlsplit(said[0].removeprefix("live page: "))
            host = url.netloc
            assert len(url.fragment) >= 32
            assert page.pid is not None
            gives_way(page.pid)
            assert not page.awaited
            urllib.request.urlopen(f"http://{host}/").close()
            until(lambda: page.awaited is waits)
            with connect(f"ws://{host}/stream", origin=f"http://{host}", proxy=None, max_size=2**24) as stream:
                until(lambda: "compiling: 43 %" in stream.recv(10))
                stream.send(json.dumps({"number": 0, "token": "", "button": "drawn"}))
                until(lambda: not page.awaited)
                given.start()
                given.join(0.5 if waits else 60.0)
                assert given.is_alive() is waits
                (tmp_path / "report.html").write_text("report")
                assert urllib.request.urlopen(f"http://{host}/report").read() == b"report"
                stream.send(json.dumps({"number": 0, "token": "", "button": "has report"}))
                given.join(60.0)
                assert not given.is_alive()
        finally:
            page.stop()
        page.show("starting")  # of one that has ended
        page.stop()
        assert not page.awaited
    assert (tmp_path / "logs" / "dashboard.log").read_text() == ""


def test_without_the_extra_the_run_reports_it_and_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.dashboard.config.NEEDS", ("starlette", "no_such_package"))
    page, lines = page_of(tmp_path)
    page.start(BusOptions(connect=("tcp/127.0.0.1:1",)))
    page.stop()
    assert lines == ["no live page: no_such_package is not installed: pip install no_such_package (extra viz)"]
