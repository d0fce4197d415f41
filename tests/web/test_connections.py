"""Connections that are neither read from nor written to by their clients are left."""

import asyncio
import socket

import pytest
import uvicorn

from cbsr_qa.web import connections
from cbsr_qa.web.guard import Right


async def _endless(scope, receive, send):
    """Send without end, as an event stream does, to a client of the right that its path names."""
    scope["cbsr_right"] = Right[scope["path"].strip("/")]
    await send({"type": "http.response.start", "status": 200, "headers": []})
    while True:
        await send({"type": "http.response.body", "body": bytes(65536), "more_body": True})
        await asyncio.sleep(0)


async def _served(app, client):
    listening = socket.create_server(("127.0.0.1", 0))
    settings = connections.connection_settings(lambda sent: False)
    config = uvicorn.Config(app, lifespan="off", log_config=None, **settings)
    server = uvicorn.Server(config)
    serving = asyncio.create_task(server._serve([listening]))
    try:
        await client(server, listening.getsockname()[1])
    finally:
        server.should_exit = server.force_exit = True
        await asyncio.wait_for(serving, 10)


@pytest.mark.parametrize("right", Right)
def test_a_client_that_does_not_read_is_left(monkeypatch, right):
    monkeypatch.setattr(connections, "SLOW_S", 0.2)

    async def deaf(server, port):
        _, writer = await asyncio.open_connection("127.0.0.1", port, limit=1)
        writer.write(f"GET /{right.name} HTTP/1.1\r\nHost: here\r\n\r\n".encode())
        await writer.drain()
        async with asyncio.timeout(10):
            while not server.server_state.connections:
                await asyncio.sleep(0.01)
            while server.server_state.connections:
                await asyncio.sleep(0.01)
        writer.close()

    asyncio.run(_served(_endless, deaf))
