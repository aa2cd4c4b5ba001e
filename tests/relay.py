"""Relays each connection to another address, in order, both directions delayed by SECONDS; one end
may close while the other still sends. `relay.py HOST:PORT TO_HOST:PORT SECONDS`"""

from __future__ import annotations

import asyncio
import contextlib
import sys

LISTEN, TARGET = (address.rsplit(":", 1) for address in sys.argv[1:3])
DELAY_S = float(sys.argv[3])


async def late(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Relays one direction until its end."""
    clock = asyncio.get_running_loop()
    waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

    async def hand_on() -> None:
        while True:
            due, chunk = await waiting.get()
            await asyncio.sleep(max(0.0, due - clock.time()))
            if not chunk:
                return writer.close()
            writer.write(chunk)
            await writer.drain()

    sender = asyncio.create_task(hand_on())
    with contextlib.suppress(ConnectionError):
        while chunk := await reader.read(65536):
            waiting.put_nowait((clock.time() + DELAY_S, chunk))
    waiting.put_nowait((clock.time() + DELAY_S, b""))
    with contextlib.suppress(ConnectionError):
        await sender


async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    there = await asyncio.open_connection(*TARGET)
    await asyncio.gather(late(reader, there[1]), late(there[0], writer))


async def main() -> None:
    async with await asyncio.start_server(accept, *LISTEN) as server:
        await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main())
