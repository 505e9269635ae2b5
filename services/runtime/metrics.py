"""Controller metrics for Prometheus: GET /metrics on loopback, in its text formats, and nothing else.

prometheus_client answers. Its server is not used alone, because it accepts any Host header: a web page whose name
resolves to this machine (DNS rebinding) sends that name as Host, and is rejected here.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from http.server import ThreadingHTTPServer

from prometheus_client import CollectorRegistry, MetricsHandler
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ltv_mpc.messages import Authority, ControllerStatus, Health, MissionAction

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
REQUEST_TIMEOUT_S = 5.0  # for a client that does not finish its request


class Metrics(Collector):
    """Collector of the newest controller status."""

    def __init__(self) -> None:
        self._status: ControllerStatus | None = None
        self.registry = CollectorRegistry()
        self.registry.register(self)

    def show(self, status: ControllerStatus) -> None:
        """Keep the newest status."""
        self._status = status

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of the newest status that have a value; none before the first status."""
        if self._status is not None:
            yield from (metric for metric in _metrics(self._status) if metric.samples)


@contextmanager
def serving(metrics: Metrics, port: int) -> Iterator[None]:
    """Serve the metrics on loopback within the context. Raises ``OSError`` if the port is in use."""

    class Handler(MetricsHandler):
        registry = metrics.registry
        timeout = REQUEST_TIMEOUT_S

        def do_GET(self) -> None:
            if self.headers.get("Host") not in (*NAMES, *(f"{name}:{port}" for name in NAMES)):
                self.send_error(HTTPStatus.FORBIDDEN)
            elif self.path != "/metrics":
                self.send_error(HTTPStatus.NOT_FOUND)
            else:
                super().do_GET()

    with ThreadingHTTPServer((HOST, port), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, name="metrics", daemon=True)
        thread.start()
        try:
            yield
        finally:
            server.shutdown()
            thread.join()


COUNTERS = {
    "received": "Messages accepted.",
    "dropped": "Messages lost on the way.",
    "rejected_estimates": "Estimates of second sources, rejected.",
    "clock_steps": "Steps of the publishers' clocks.",
    "checkpoints_failed": "Checkpoints not written.",
}
"""Fields of a status that count something."""


def _metrics(s: ControllerStatus) -> Iterator[Metric]:
    for name, help_ in COUNTERS.items():
        yield CounterMetricFamily(f"ltv_mpc_{name}", help_, getattr(s, name))
    rejected = CounterMetricFamily("ltv_mpc_rejected", "Messages rejected, by reason.", labels=("reason",))
    for reason, count in s.rejected.items():
        rejected.add_metric((reason,), count)
    yield rejected
    ages = {"estimate": _seconds(s.estimate_age_ns), "applied": _seconds(s.applied_age_ns)}
    yield _gauge("input_age_seconds", "Age of the newest input of each key.", "key", ages)
    cycle = {"0.5": s.cycle_median_us, "0.99": s.cycle_p99_us}
    quantiles = {share: None if us is None else us / 1e6 for share, us in cycle.items()}
    yield _gauge("cycle_seconds", "Wall time of a cycle over the last 10 s.", "quantile", quantiles)
    used = "1 for the source of the estimates in use, 0 for a rejected one."
    sources = GaugeMetricFamily("ltv_mpc_source", used, labels=("name", "epoch"))
    for epoch, share in ((s.source_epoch, 1.0), (s.rejected_epoch, 0.0)):
        if epoch:
            sources.add_metric((s.source, str(epoch)), share)
    yield sources
    clock_error_s = _seconds(s.clock_error_ns)
    yield GaugeMetricFamily("ltv_mpc_clock_error_seconds", "Bound of the clock error.", clock_error_s)
    yield GaugeMetricFamily("ltv_mpc_tracking_error_metres", "Distance from the estimate to the reference.", s.error_m)
    yield GaugeMetricFamily("ltv_mpc_progress_ratio", "Completed share of the reference.", s.progress)
    yield _one_of("authority", "Source of the thruster commands.", s.authority, Authority)
    yield _one_of("health", "Health of the inputs.", s.health, Health)
    yield _one_of("mission_action", "Action of the mission policy.", s.mission_action, MissionAction)


def _gauge(name: str, help_: str, label: str, values: Mapping[str, float | None]) -> Metric:
    """Return a gauge with one sample for each known value."""
    gauge = GaugeMetricFamily(f"ltv_mpc_{name}", help_, labels=(label,))
    for key, value in values.items():
        if value is not None:
            gauge.add_metric((key,), value)
    return gauge


def _one_of(name: str, help_: str, value: str, values: Iterable[str]) -> Metric:
    """Return a gauge that is 1 for the current value and 0 for the others."""
    return _gauge(name, help_, name, {str(one): float(one == value) for one in values})


def _seconds(ns: int | None) -> float | None:
    return None if ns is None else ns / 1e9
