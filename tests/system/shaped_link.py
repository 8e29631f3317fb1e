"""A slow network in one process: a TCP proxy with a rate and a delay each way, which can also be cut without a sign."""

from __future__ import annotations

import asyncio
import threading

_SEGMENT = 1400
_WITHIN_S = 20.0


class _Direction:
    """One way of the line: all connections share its rate."""

    def __init__(self, bits_per_s: float) -> None:
        self._bits_per_s = bits_per_s
        self._free_s = 0.0

    async def pass_through(self, size: int) -> None:
        """Wait until this number of bytes has left the sender."""
        loop = asyncio.get_running_loop()
        self._free_s = max(self._free_s, loop.time()) + 8 * size / self._bits_per_s
        await asyncio.sleep(self._free_s - loop.time())


class ShapedLink:
    """Forwards a port of its own to another one.

    Parameters
    ----------
    target
        Port on loopback.
    bits_per_s
        Rate in each direction; infinite = as fast as it goes.
    delay_s
        Added one way.
    """

    def __init__(self, target: int, bits_per_s: float = float("inf"), delay_s: float = 0.0) -> None:
        self._target, self._delay_s = target, delay_s
        self._up, self._down = _Direction(bits_per_s), _Direction(bits_per_s)
        self._loop = asyncio.new_event_loop()
        self._whole = asyncio.Event()
        self._whole.set()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._server = self._run(asyncio.start_server(self._connected, "127.0.0.1", 0, limit=4 * _SEGMENT))
        self.port = self._server.sockets[0].getsockname()[1]

    def cut(self) -> None:
        """Let nothing through any more; the connections stay open."""
        self._loop.call_soon_threadsafe(self._whole.clear)

    def mend(self) -> None:
        """Let everything through again."""
        self._loop.call_soon_threadsafe(self._whole.set)

    def close(self) -> None:
        async def end() -> None:
            self._server.close()
            tasks = asyncio.all_tasks() - {asyncio.current_task()}
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

        self._run(end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_WITHIN_S)
        self._loop.close()

    def _run(self, work):  # type: ignore[no-untyped-def]
        return asyncio.run_coroutine_threadsafe(work, self._loop).result(_WITHIN_S)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target, limit=4 * _SEGMENT)
            ways = [self._forward(reader, far_writer, self._up), self._forward(far_reader, writer, self._down)]
            done, others = await asyncio.wait([asyncio.ensure_future(w) for w in ways], return_when="FIRST_COMPLETED")
            for other in others:
                other.cancel()
            await asyncio.gather(*done, *others, return_exceptions=True)
            far_writer.close()
        except (OSError, asyncio.CancelledError):
            pass
        finally:
            writer.close()

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, way: _Direction) -> None:
        arriving: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        delivering = asyncio.ensure_future(self._deliver(arriving, writer))
        try:
            while data := await reader.read(_SEGMENT):
                await way.pass_through(len(data))
                arriving.put_nowait((self._loop.time() + self._delay_s, data))
            await asyncio.sleep(self._delay_s)
        finally:
            delivering.cancel()
            await asyncio.gather(delivering, return_exceptions=True)

    async def _deliver(self, arriving: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter) -> None:
        while True:
            at_s, data = await arriving.get()
            await asyncio.sleep(max(at_s - self._loop.time(), 0.0))
            await self._whole.wait()
            writer.write(data)
            await writer.drain()
