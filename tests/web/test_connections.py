"""Connections that are neither read from nor written to by their clients are left."""

import asyncio
import socket

import pytest
import uvicorn

from cbsr_qa.web import connections
from cbsr_qa.web.guard import Right
from tests.samples.loops import run_coroutine


async def _endless(scope, receive, send):
    """Send without end, as an event stream does, to a client of the right that its path names."""
    scope["cbsr_right"] = Right[scope["path"].strip("/")]
    await send({"type": "http.response.start", "status": 200, "headers": []})
    while True:
        await send({"type": "http.response.body", "body": bytes(65536), "more_body": True})
        await asyncio.sleep(0)


async def _served(app, client, shows_token=lambda sent: False):
    listening = socket.create_server(("127.0.0.1", 0))
    settings = connections.connection_settings(shows_token)
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

    run_coroutine(_served(_endless, deaf))


async def _short(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"0")]})
    await send({"type": "http.response.body", "body": b""})


def test_of_what_a_stranger_sends_a_head_is_searched_and_little_is_kept(monkeypatch):
    looks, kept = [], []
    monkeypatch.setattr(connections.Connection, "read_received", lambda self: kept.append(len(self._unread)))

    async def loud(server, port):
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        for _ in range(50):
            writer.write(b"x" * 10_000)
            await asyncio.sleep(0.01)
        (connection,) = server.server_state.connections
        kept.append(len(connection._unread))
        writer.transport.abort()

    run_coroutine(_served(_short, loud, lambda sent: looks.append(len(sent))))
    assert sum(looks) <= 2 * connections.MAX_HEAD_BYTES
    assert kept[-1] <= connections.MAX_HEAD_BYTES + 2**18  # what one call of the system brings


def test_a_token_is_seen_that_arrives_in_two_parts_while_the_connection_waits(monkeypatch):
    turns = []
    monkeypatch.setattr(connections.Connection, "read_received", lambda self: turns.append(self._has_shown_token))

    async def late(server, port):
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        for part in (b"GET / HTTP/1.1\r\nA: " + b"b" * 5_000 + b"\r\nAuthorization: Bearer to", b"ken\r\n"):
            writer.write(part)
            await asyncio.sleep(0.1)
        writer.transport.abort()

    run_coroutine(_served(_short, late, lambda sent: b"Bearer token" in sent))
    assert turns == [False, True]


def test_requests_that_a_stranger_sends_at_once_are_answered_a_turn_each(monkeypatch):
    reads = []
    read = connections.Connection.read_received
    monkeypatch.setattr(connections.Connection, "read_received", lambda self: (reads.append(self), read(self)))

    async def hasty(server, port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\nHost: here\r\n\r\n" * 500)
        for _ in range(500):
            assert b"200" in await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 10)
        writer.close()

    run_coroutine(_served(_short, hasty))
    assert len(reads) >= 500
