"""A long link, on loopback: a TCP proxy that delays what passes, in order, and stalls as TCP does over a lossy link.

    python delaying_proxy.py FROM_PORT TO_PORT [--delay-ms 50] [--jitter-ms 20] [--loss 0.05] [--seed 0]

Each direction of each connection by itself. Every segment takes delay +- jitter (uniform). One that is lost, with the
given probability, comes as long later as its sender needs to notice: its retransmission timeout, twice that if the
second try is lost too, and so on. TCP keeps the order, so all that follows waits behind it.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import random

SEGMENT_BYTES = 1448  # what fits into an Ethernet frame beside both headers
MIN_TIMEOUT_S = 0.2  # Linux's smallest variance term: the timeout is the round trip and this


class Link:
    """One direction of the link: ``delay_s`` +- ``jitter_s`` for each segment, of which the share ``loss`` is lost."""

    def __init__(self, delay_s: float, jitter_s: float, loss: float, rng: random.Random) -> None:
        self._delay_s, self._jitter_s, self._loss, self._rng = delay_s, jitter_s, loss, rng
        self._free_s = 0.0  # nothing comes before what was sent before it

    def arrival_s(self, now_s: float) -> float:
        """Return the arrival time of the next segment (s)."""
        stall_s, timeout_s = 0.0, 2 * self._delay_s + MIN_TIMEOUT_S
        while self._rng.random() < self._loss:
            stall_s += timeout_s
            timeout_s *= 2
        taken_s = self._delay_s + self._rng.uniform(-self._jitter_s, self._jitter_s)
        self._free_s = max(self._free_s, now_s + taken_s + stall_s)
        return self._free_s


async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, link: Link) -> None:
    """Until the sender closes; then what is on its way still arrives."""
    loop = asyncio.get_running_loop()
    on_its_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

    async def deliver() -> None:
        while (item := await on_its_way.get())[1]:
            await asyncio.sleep(max(0.0, item[0] - loop.time()))
            writer.write(item[1])
            await writer.drain()

    delivery = asyncio.create_task(deliver())
    with contextlib.suppress(ConnectionError):
        while segment := await reader.read(SEGMENT_BYTES):
            on_its_way.put_nowait((link.arrival_s(loop.time()), segment))
    on_its_way.put_nowait((0.0, b""))
    with contextlib.suppress(ConnectionError):
        await delivery
    writer.close()


async def serve(options: argparse.Namespace) -> None:
    rng = random.Random(options.seed)

    def link() -> Link:
        return Link(options.delay_ms / 1e3, options.jitter_ms / 1e3, options.loss, rng)

    async def connected(near_in: asyncio.StreamReader, near_out: asyncio.StreamWriter) -> None:
        try:
            far_in, far_out = await asyncio.open_connection("127.0.0.1", options.to_port)
        except OSError:
            near_out.close()
            return
        await asyncio.gather(carry(near_in, far_out, link()), carry(far_in, near_out, link()))

    server = await asyncio.start_server(connected, "127.0.0.1", options.from_port)
    print("ready", flush=True)  # noqa: T201
    async with server:
        await server.serve_forever()


def main() -> None:
    parser = argparse.ArgumentParser(description="A long link, on loopback.")
    parser.add_argument("from_port", type=int)
    parser.add_argument("to_port", type=int)
    parser.add_argument("--delay-ms", type=float, default=50.0)
    parser.add_argument("--jitter-ms", type=float, default=20.0)
    parser.add_argument("--loss", type=float, default=0.05)
    parser.add_argument("--seed", type=int, default=0)
    asyncio.run(serve(parser.parse_args()))


if __name__ == "__main__":
    main()
