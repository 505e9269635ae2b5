"""Server of the live page: who may read, who may command, and the content of the stream."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import http.client
import json
import socket
from collections.abc import Iterator
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from ltv_mpc.messages import ClockCommand, Command, Disturbance, Heartbeat, Kill
from services.dashboard.access_guard import Token, hosts
from services.dashboard.config import View
from services.dashboard.serve import Connection
from services.dashboard.stream import MAX_READERS
from services.reporting import static_files
from tests.services.dashboard.synthetic_vehicle import SPEED, Served, served
from tests.services.reporting.synthetic_run import NODES, OFFSET
from tests.waiting import until


@pytest.fixture(scope="module")
def page(free_port: int) -> Iterator[Served]:
    with served(free_port) as made:
        yield made


def get(page: Served, path: str = "/", method: str = "GET", **headers: str) -> tuple[int, str, dict[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    connection.putrequest(method, path, skip_host=True)
    for name, value in ({"Host": page.host} | headers).items():
        connection.putheader(name, value)
    connection.endheaders()
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text, {name.lower(): value for name, value in answer.getheaders()}


def stream(page: Served, origin: str | None = None, **headers: str) -> ClientConnection:
    """Open the stream; ``origin`` is that of the page by default, none if it is empty."""
    claimed: Any = page.url.rstrip("/") if origin is None else origin or None
    where = f"ws://127.0.0.1:{page.port}/stream"
    return connect(where, origin=claimed, additional_headers=headers, proxy=None, max_size=2**24)


def next_text(socket: ClientConnection, kind: str) -> dict[str, Any]:
    """Return the next text of this kind."""
    while True:
        text: dict[str, Any] = json.loads(socket.recv(10))
        if text["kind"] == kind:
            return text


def pressed(page: Served, socket: ClientConnection, **asked: object) -> dict[str, Any]:
    socket.send(json.dumps({"number": 5, "token": page.token, **asked}))
    return next_text(socket, "reply")


# --- places ----------------------------------------------------------------------------------------------------------


def test_readers_without_the_token_cannot_lock_out_the_operator(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.dashboard.stream.MAX_WAITING", 3)
    monkeypatch.setattr("services.dashboard.page.TOKEN_S", 60.0)
    with contextlib.ExitStack() as sockets:
        readers = [sockets.enter_context(stream(page)) for _ in range(MAX_READERS)]
        for reader in readers:
            next_text(reader, "whole")
        operator = sockets.enter_context(stream(page))
        assert pressed(page, operator, button="kill", node="nobody")["done"] is False
        next_text(operator, "whole")
        waiting = [sockets.enter_context(stream(page)) for _ in range(4)]
        with pytest.raises(ConnectionClosed, match="32 pages are open already"):
            next_text(waiting[0], "whole")  # in its place waits the last one
        pressed(page, waiting[3], button="kill", node="nobody")
        for reader in (operator, waiting[3], *readers):
            next_text(reader, "tick")
        pressed(page, readers[0], button="kill", node="nobody")
        until(lambda: stream_has_a_place(page))


def stream_has_a_place(page: Served) -> bool:
    with stream(page) as another:
        try:
            while json.loads(another.recv(0.5))["kind"] != "whole":
                pass
        except TimeoutError:
            return False
        return True


def test_a_reader_that_does_not_show_the_token_soon_makes_room(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.dashboard.stream.MAX_READERS", 0)
    monkeypatch.setattr("services.dashboard.page.TOKEN_S", 0.1)
    with stream(page) as reader, pytest.raises(ConnectionClosed, match="1013"):
        next_text(reader, "whole")


@pytest.mark.parametrize("sent", [b"", b"GET / HTTP/1.1\r\n", b"GET /page/plotly.js HTTP/1.1\r\nHost: {host}\r\n\r\n"])
def test_an_idle_socket_ends(page: Served, sent: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that sends nothing, half a request, or reads nothing of a large answer."""
    monkeypatch.setattr("services.dashboard.serve.IDLE_S", 0.2)
    with socket.create_connection(("127.0.0.1", page.port)) as idle:
        idle.sendall(sent.replace(b"{host}", page.host.encode()))
        until(lambda: not any(isinstance(one, Connection) for one in page.server.server_state.connections))


def test_a_socket_above_the_limit_takes_the_place_of_an_idle_one(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.dashboard.serve.MAX_SOCKETS", 5)
    with contextlib.ExitStack() as sockets:
        idle = [sockets.enter_context(socket.create_connection(("127.0.0.1", page.port))) for _ in range(20)]
        assert get(page)[0] == 200
        with contextlib.suppress(ConnectionResetError):
            assert idle[0].recv(1) == b""


# --- who may read ----------------------------------------------------------------------------------------------------


def test_the_page_and_its_files_come_from_here_and_may_load_nothing_else(page: Served) -> None:
    for path, part in (("/", "<!DOCTYPE html>"), ("/page/live.js", "WebSocket"), ("/page/plotly.js", "plotly.js v")):
        status, text, headers = get(page, path)
        assert status == 200
        assert part in text
        assert "default-src 'none'" in headers["content-security-policy"]
        assert headers["x-frame-options"] == "DENY"
        assert "access-control-allow-origin" not in headers


def test_the_report_is_given_once_it_is_written_and_only_its_own_scripts_may_run(page: Served) -> None:
    assert get(page, "/report")[:2] == (204, "")
    plotly, script = static_files.report_scripts()
    page.report.write_text(f"<script>{script}</script>")
    try:
        status, text, headers = get(page, "/report")
    finally:
        page.report.unlink()
    assert (status, text) == (200, f"<script>{script}</script>")
    hashes = [base64.b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in (plotly, script)]
    (policy,) = (one for one in headers["content-security-policy"].split("; ") if one.startswith("script-src"))
    assert policy == f"script-src 'self' 'sha256-{hashes[0]}' 'sha256-{hashes[1]}'"


def say(page: Served, socket: ClientConnection, what: str) -> None:
    socket.send(json.dumps({"number": 0, "token": page.token, "button": what}))


def test_the_report_is_with_all_when_the_last_one_has_it_or_leaves(page: Served) -> None:
    with stream(page) as first, stream(page) as second:
        for socket in (first, second):
            next_text(socket, "hello")
            say(page, socket, "drawn")
        until(lambda: page.views[-2:] == [View.DRAWN, View.DRAWN])
        del page.views[:]
        say(page, first, "has report")
        say(page, first, "drawn")  # a slow page may have the report before it has drawn everything
        assert pressed(page, first, button="kill", node="nobody")["done"] is False  # all before it is done
        assert page.views == []
        second.close()
        until(lambda: page.views == [View.HAS_REPORT])
    until(lambda: page.views[-1] is View.CLOSED)


EVIL = "http://evil.example"
REQUESTS: list[tuple[int, dict[str, str]]] = [
    *((404, {"path": path}) for path in ("/page/../serve.py", "/page/%2e%2e%2fserve.py", "/page/no.js", "/etc/passwd")),
    (405, {"method": "POST"}),
    *((200, {"Host": f"{name}:{{port}}"}) for name in ("localhost", "LOCALHOST", "[::1]")),
    # DNS rebinding: a foreign name that resolves to this machine
    *((403, {"Host": name}) for name in ("evil.example", "evil.example:{port}", "127.0.0.1.evil:{port}")),
    *((403, {"Host": name, "path": "/page/live.js"}) for name in ("127.0.0.1", "127.0.0.1:1")),
    *((403, {"Origin": origin}) for origin in (EVIL, "https://127.0.0.1:{port}", "http://127.0.0.1:1", "null")),
]


@pytest.mark.parametrize(("status", "asked"), REQUESTS)
def test_only_this_page_by_its_own_names_is_given(page: Served, status: int, asked: dict[str, str]) -> None:
    assert get(page, **{name: value.format(port=page.port) for name, value in asked.items()})[0] == status


@pytest.mark.parametrize("origin", ["", EVIL, "https://127.0.0.1:{port}", "http://127.0.0.1:1", "null"])
def test_a_websocket_of_another_page_or_of_none_is_refused(page: Served, origin: str) -> None:
    with pytest.raises(InvalidStatus) as refused, stream(page, origin.format(port=page.port)):
        pass
    assert refused.value.response.status_code == 403
    evil = f"evil.example:{page.port}"  # another name for this machine
    with pytest.raises(InvalidStatus) as refused, stream(page, f"http://{evil}", Host=evil):
        pass
    assert refused.value.response.status_code in (400, 403)


# --- who may command -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("token", ["", "x", "{token}x", "é"])
def test_without_the_token_nothing_can_be_commanded(page: Served, token: str) -> None:
    before = len(page.vehicle.received)
    with stream(page) as socket:
        for button in ("arm", "stop", "pause", "kick", "kill"):
            answer = pressed(page, socket, token=token.format(token=page.token), button=button, node="controller")
            assert (answer["number"], answer["done"]) == (5, False)
            assert answer["text"].startswith("read-only")
    assert len(page.vehicle.received) == before


def test_each_start_has_another_token() -> None:
    one, other = Token(), Token()
    assert (len(one.text) >= 32, one.matches(one.text), one.matches(other.text)) == (True, True, False)
    assert "127.0.0.1" in hosts(["127.0.0.1"], 80)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"number": 1, "token": "TOKEN", "button": "format"}',
        '{"number": 1, "token": "TOKEN", "button": "speed", "speed": 1e9}',
        '{"number": 1, "token": "TOKEN", "button": "arm", "more": 1}',
        '{"number": 1, "token": "TOKEN", "button": "kill", "node": "' + 41 * "x" + '"}',
    ],
)
def test_what_is_no_command_is_answered_and_does_nothing(page: Served, text: str) -> None:
    before = len(page.vehicle.received)
    with stream(page) as socket:
        socket.send(text.replace("TOKEN", page.token))
        answer = next_text(socket, "reply")
    assert (answer["done"], answer["text"][:15]) == (False, "no such command")
    assert len(page.vehicle.received) == before


def test_a_kill_that_names_no_process_of_the_run_is_refused(page: Served) -> None:
    before = len(page.vehicle.received)
    with stream(page) as socket:
        until(lambda: page.feed.status().simulated)
        answers = [pressed(page, socket, button="kill", **node) for node in ({}, {"node": "nobody"})]
    assert [answer["done"] for answer in answers] == [False, False]
    assert answers[1]["text"].startswith('kill refused: "nobody": must be one of ')
    assert len(page.vehicle.received) == before


def test_who_sends_a_flood_is_cut_off(page: Served) -> None:
    with stream(page) as socket:
        socket.send(100_000 * "x")
        with pytest.raises(ConnectionClosed):
            next_text(socket, "reply")


def test_a_page_with_the_token_is_a_sign_of_an_operator(page: Served) -> None:
    heartbeat = {"number": 0, "button": "heartbeat"}
    until(lambda: page.feed.status().processes)
    with stream(page) as socket:
        socket.send(json.dumps(heartbeat | {"token": ""}))
        assert next_text(socket, "reply")["text"].startswith("read-only")
        assert page.vehicle.received_of(Heartbeat) == []
        for _ in range(2):
            socket.send(json.dumps(heartbeat | {"token": page.token}))
        until(lambda: len(page.vehicle.received_of(Heartbeat)) == 2)


def test_buttons_send_what_they_say_and_show_the_controller_s_answer(page: Served) -> None:
    vehicle, feed = page.vehicle, page.feed
    with stream(page) as socket:
        until(lambda: feed.status().simulated)
        answer = pressed(page, socket, button="stop")
        assert (answer["done"], answer["text"]) == (True, "stop: accepted; command authority: controller")
        refused = pressed(page, socket, button="hold")
        assert not refused["done"]
        assert refused["text"] == "hold: rejected: nothing to hold; command authority: controller"
        assert pressed(page, socket, button="kill", node="estimator")["done"]
        assert pressed(page, socket, button="kick")["done"]
        asked_s = feed.status().t_s
        assert pressed(page, socket, button="speed", speed=4.0)["done"]
        until(lambda: feed.status().speed == 4.0)
        assert pressed(page, socket, button="pause")["done"]
        until(lambda: feed.status().clock == "paused")
        assert pressed(page, socket, button="resume")["done"]
        until(lambda: feed.status().clock == "running")
        assert pressed(page, socket, button="speed", speed=SPEED)["done"]
        until(lambda: feed.status().speed == SPEED)
    assert [command.action for command in vehicle.received_of(Command)] == ["stop", "hold"]
    assert [kill.node for kill in vehicle.received_of(Kill)] == ["estimator"]
    (kick,) = vehicle.received_of(Disturbance)
    assert asked_s is not None
    assert 0 < kick.end_t_ns / 1e9 <= asked_s + 2.0
    asked = [(one.paused, one.speed) for one in vehicle.received_of(ClockCommand)]
    assert asked == [(False, 4.0), (True, 4.0), (False, 4.0), (False, SPEED)]


# --- what the stream brings ------------------------------------------------------------------------------------------


def test_a_reader_gets_everything_and_then_what_is_new(page: Served) -> None:
    until(lambda: len(page.feed.collector.tables["errors"]) > 5)
    with stream(page) as socket:
        assert next_text(socket, "hello")["plots"][0]["name"] == "track"
        whole = next_text(socket, "whole")
        assert whole["rows"]["truth"]["east_m"][0] == pytest.approx(OFFSET[1], abs=0.2)  # 20 s of drift
        assert whole["marks"]
        times = list(whole["rows"]["track"]["t_s"])
        wanted = len(times) + 10
        while len(times) < wanted:
            tick = next_text(socket, "tick")
            assert "track" not in tick["replaced"]
            times += tick["rows"].get("track", {}).get("t_s", [])
        assert times == sorted(set(times))
        moment = tick["status"]
    assert {process["name"] for process in moment["processes"]} == set(NODES)
    assert moment["simulated"]
    assert moment["ages_s"]["plan"] >= 0
    assert tick["values"]["port_max_N"] == 62.5
    assert tick["tables"]["ellipse"]["north_m"]


def test_another_run_on_the_same_keys_begins_with_an_empty_page(page: Served) -> None:
    until(lambda: len(page.feed.collector.tables["track"]) > 20)
    with stream(page) as socket:
        before = next_text(socket, "whole")["rows"]["track"]["t_s"]
        page.vehicle.restart()
        after = next_text(socket, "whole")["rows"].get("track", {"t_s": []})["t_s"]
    assert len(after) < len(before)
