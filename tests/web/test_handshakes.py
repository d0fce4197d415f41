"""Handshakes of TLS that strangers begin and do not end keep no one else from theirs."""

import asyncio
import datetime
import ipaddress
import socket
import ssl
from contextlib import ExitStack

import pytest

from cbsr_qa.web import handshakes
from tests.samples.loops import run_coroutine

_BEGUN = bytes.fromhex("16030102000100")  # type, version and length of a record, and two of its 512 bytes
_ANSWER = b"an answer"


@pytest.fixture(scope="module")
def contexts(tmp_path_factory):
    """Contexts of TLS of a server, and of a client that knows its certificate."""
    pytest.importorskip("cryptography")
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key, now = ec.generate_private_key(ec.SECP256R1()), datetime.datetime.now(datetime.UTC)
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "localhost")])
    address = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), 1, now, now + datetime.timedelta(1))
        .add_extension(address, critical=False)
        .sign(key, hashes.SHA256())
        .public_bytes(serialization.Encoding.PEM)
    )
    file = tmp_path_factory.mktemp("tls") / "line.pem"
    plain = serialization.NoEncryption()
    file.write_bytes(
        certificate + key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
    )
    server = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    server.load_cert_chain(file)
    return server, ssl.create_default_context(cadata=certificate.decode())


class _Answering(asyncio.Protocol):
    def connection_made(self, transport):
        transport.write(_ANSWER)
        transport.close()


async def _answered(port, client):
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=client, server_hostname="127.0.0.1")
    try:
        return await reader.read()
    finally:
        writer.close()


def _serve(contexts, ask):
    """Run ``ask(port, client context)`` beside a server on its loop."""
    server, client = contexts

    async def serve():
        listening = handshakes.ListeningSocket(socket.AF_INET, socket.SOCK_STREAM)
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        loop = asyncio.get_running_loop()
        served = await loop.create_server(_Answering, sock=listening, ssl=server, backlog=32)
        try:
            return await ask(listening.getsockname()[1], client)
        finally:
            served.close()
            await served.wait_closed()
            listening.close()

    return run_coroutine(serve(), handshakes.ServerLoop)


def _opened(port, sent):
    connection = socket.create_connection(("127.0.0.1", port), timeout=5)
    connection.sendall(sent)
    return connection


def test_a_client_is_answered_over_tls(contexts):
    assert _serve(contexts, _answered) == _ANSWER


@pytest.mark.parametrize("sent", [_BEGUN, _BEGUN[:3], b""], ids=["begun", "not-even-a-header", "nothing"])
def test_six_hundred_handshakes_that_stall_keep_nobody_out(contexts, sent):
    async def ask(port, client):
        with ExitStack() as stalled:
            for _ in range(600):  # more than there are places
                stalled.enter_context(await asyncio.to_thread(_opened, port, sent))
            async with asyncio.timeout(2):
                return await _answered(port, client)

    assert _serve(contexts, ask) == _ANSWER


def test_a_hello_in_pieces_is_heard(contexts):
    async def ask(port, client):
        incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        tls = client.wrap_bio(incoming, outgoing, server_hostname="127.0.0.1")
        with pytest.raises(ssl.SSLWantReadError):
            tls.do_handshake()
        hello = outgoing.read()
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for piece in (hello[:3], hello[3:90], hello[90:]):
            writer.write(piece)
            await asyncio.sleep(0.1)
        async with asyncio.timeout(2):
            said = await reader.read(1)
        writer.close()
        return said

    assert _serve(contexts, ask) == b"\x16"  # a record of its handshake


@pytest.mark.parametrize(
    "sent", [b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\xff\xff" + bytes(90)], ids=["not-tls", "too-long"]
)
def test_what_is_no_hello_is_left_at_once(contexts, sent):
    async def ask(port, client):
        with await asyncio.to_thread(_opened, port, sent) as connection:
            return await asyncio.to_thread(connection.recv, 1)

    try:
        assert _serve(contexts, ask) == b""
    except ConnectionResetError:  # it was closed with something unread
        return


def test_a_hello_that_does_not_come_is_not_awaited(contexts, monkeypatch):
    monkeypatch.setattr(handshakes, "HEAD_S", 0.2)
    monkeypatch.setattr(handshakes, "_SWEEP_S", 0.1)

    async def ask(port, client):
        with await asyncio.to_thread(_opened, port, _BEGUN) as connection:
            try:
                return await asyncio.to_thread(connection.recv, 1)
            except ConnectionResetError:
                return b""

    assert _serve(contexts, ask) == b""


def test_the_handshake_itself_is_timed(contexts, monkeypatch):
    """A client that says hello in full, and nothing after it."""
    monkeypatch.setattr(handshakes, "HEAD_S", 0.3)

    async def ask(port, client):
        incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        with pytest.raises(ssl.SSLWantReadError):
            client.wrap_bio(incoming, outgoing, server_hostname="127.0.0.1").do_handshake()
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(outgoing.read())
        async with asyncio.timeout(3):
            said = await reader.read()
        writer.close()
        return said

    assert _serve(contexts, ask)[:1] == b"\x16"
