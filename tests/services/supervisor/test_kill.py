"""An operator's request to kill a process reaches the supervisor."""

from __future__ import annotations

from ltv_mpc.messages import Kill
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.bus.topics import OPERATOR
from services.supervisor.bus_monitor import BusMonitor
from tests.waiting import until


def test_each_kill_request_is_returned_once(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with (
        open_session(BusOptions(listen=(endpoint,)), stop=lambda: False, say=print) as here,
        open_session(BusOptions(connect=(endpoint,)), stop=lambda: False, say=print) as there,
    ):
        watch = BusMonitor(here, ["estimator"])
        out = Outbox(there, node=OPERATOR, epoch=1, kinds=(Kill,))
        heard: list[str] = []

        def hear() -> bool:
            out.publish(Kill(node="estimator"))
            heard.extend(watch.kill_requests())
            return heard != []

        until(hear)
        assert set(heard) == {"estimator"}
