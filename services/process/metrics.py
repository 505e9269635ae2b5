"""The controller's state for Prometheus: GET /metrics on loopback, in its text format 0.0.4, and nothing else.

A page in a browser that was led here by a name of its own (DNS rebinding) sends that name as Host: it is refused.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from ltv_mpc.messages import Authority, ControllerStatus, Health

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
PATIENCE_S = 5.0  # with a client that does not finish its request


class Metrics:
    """Holds the newest state for whoever asks."""

    def __init__(self) -> None:
        self._status: ControllerStatus | None = None

    def show(self, status: ControllerStatus, now_us: int) -> None:
        """The newest state."""
        del now_us
        self._status = status

    def text(self) -> str:
        """What is scraped; nothing before the first state."""
        return "" if self._status is None else "".join(_lines(self._status))


@contextmanager
def serving(metrics: Metrics, port: int) -> Iterator[None]:
    """Answer on loopback while this lasts. Raises ``OSError`` where the port is taken."""

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE_S

        def do_GET(self) -> None:
            if self.headers.get("Host") not in (*NAMES, *(f"{name}:{port}" for name in NAMES)):
                self.send_error(HTTPStatus.FORBIDDEN)
            elif self.path != "/metrics":
                self.send_error(HTTPStatus.NOT_FOUND)
            else:
                body = metrics.text().encode()
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", CONTENT_TYPE)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            del format, args  # a line for each scrape is nothing to read

    with ThreadingHTTPServer((HOST, port), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, name="metrics", daemon=True)
        thread.start()
        try:
            yield
        finally:
            server.shutdown()
            thread.join()


def _lines(s: ControllerStatus) -> Iterator[str]:
    def family(name: str, kind: str, help_: str, samples: Iterable[tuple[str, float | None]]) -> Iterator[str]:
        known = [(labels, value) for labels, value in samples if value is not None]
        if known:
            yield f"# HELP ltv_mpc_{name} {help_}\n# TYPE ltv_mpc_{name} {kind}\n"
            yield from (f"ltv_mpc_{name}{labels} {value:.9g}\n" for labels, value in known)

    def one_of(name: str, help_: str, value: str, words: Iterable[str]) -> Iterator[str]:
        return family(name, "gauge", help_, [(f'{{{name}="{word}"}}', float(word == value)) for word in words])

    yield from family(
        "input_age_seconds",
        "gauge",
        "Age of the newest input of each key.",
        [('{key="estimate"}', _seconds(s.estimate_age_ns)), ('{key="applied"}', _seconds(s.applied_age_ns))],
    )
    quantiles = [("0.5", s.cycle_median_us), ("0.99", s.cycle_p99_us)]
    yield from family(
        "cycle_seconds",
        "gauge",
        "Wall time of a cycle over the last 10 s.",
        [(f'{{quantile="{share}"}}', None if us is None else us / 1e6) for share, us in quantiles],
    )
    yield from family("received_total", "counter", "Messages let in.", [("", s.received)])
    yield from family("dropped_total", "counter", "Messages sent that never came.", [("", s.dropped)])
    yield from family(
        "rejected_total",
        "counter",
        "Messages refused, by reason.",
        [(f'{{reason="{_escaped(reason)}"}}', count) for reason, count in s.rejected.items()],
    )
    yield from family("clock_error_seconds", "gauge", "Bound of the clock's error.", [("", _seconds(s.clock_error_ns))])
    yield from family("tracking_error_metres", "gauge", "Estimate to reference.", [("", s.error_m)])
    yield from family("progress_ratio", "gauge", "Along the reference.", [("", s.progress)])
    yield from one_of("authority", "Who commands the thrusters.", s.authority, Authority)
    yield from one_of("health", "How well the inputs keep up.", s.health, Health)


def _seconds(ns: int | None) -> float | None:
    return None if ns is None else ns / 1e9


def _escaped(label: str) -> str:
    return label.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
