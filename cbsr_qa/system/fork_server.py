"""A process that forks children for this one; it has nothing open that they could share.

It has a single thread, and no database, device or lock. A command that reads files begins it by a fork before it
opens anything (:func:`begin_fork_server`); elsewhere it is a new interpreter, begun when a child is first asked for.
It imports the modules of the children once, so that a child takes milliseconds. It ends with the process that began
it. Only on Linux.
"""

import atexit
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Final

#: Environment variables by which numerical libraries start no threads in the server.
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: Form of an answer: a process number, an error number (negative), or a status.
_NUMBER: Final = struct.Struct("<i")
_FORK: Final = b"F"
_END: Final = b"E"
_MAX_REQUEST_BYTES: Final = 1 << 16
_MAX_FILES: Final = 1 << 16

_servers: dict[int, "ForkServer"] = {}
_starting: Final = threading.Lock()


class ForkServer:
    """The fork server as its parent process uses it.

    Parameters
    ----------
    requests : socket connected to the server.
    process : process number of the server.
    """

    def __init__(self, requests: socket.socket, process: int) -> None:
        self._requests, self._process = requests, process
        self._lock = threading.Lock()

    def fork(self, task: bytes, outgoing: int, modules: Sequence[str]) -> int:
        """Fork a child that calls a pickled function with a descriptor; return its process number.

        OSError if there is no process or memory left; ConnectionError if the server has died.

        Parameters
        ----------
        task : pickled function; unpickled in the child, in this process's folder and with its module path.
        outgoing : descriptor that the child is given.
        modules : modules to import before the fork; all later children share them.
        """
        try:
            folder = str(Path.cwd())
        except FileNotFoundError:  # it was removed, and paths relative to it name nothing
            folder = "/"
        content = os.memfd_create("cbsr-qa-task")
        try:
            with os.fdopen(os.dup(content), "wb") as file:
                pickle.dump((sys.path, folder, task), file)
            with self._lock:
                message = _FORK + "\n".join(modules).encode()
                socket.send_fds(self._requests, [message], [content, outgoing])
                child = self._receive_number()
        finally:
            os.close(content)
        if child < 0:
            raise OSError(-child, os.strerror(-child))
        return child

    def end(self, child: int) -> int:
        """Kill a child, unless it has ended; return its status, 0 if the server has died with it."""
        with self._lock, suppress(ConnectionError):
            self._requests.send(_END + _NUMBER.pack(child))
            return self._receive_number()
        return 0

    def has_ended(self) -> bool:
        """Whether the server has died."""
        with suppress(ChildProcessError):
            return os.waitpid(self._process, os.WNOHANG)[0] != 0
        return True

    def close(self) -> None:
        """End the server, and wait for its end."""
        self._requests.close()
        with suppress(ChildProcessError):
            os.waitpid(self._process, 0)

    def _receive_number(self) -> int:
        answer = self._requests.recv(_NUMBER.size)
        if not answer:
            raise ConnectionResetError("the process that forks for this one has ended")
        number: int = _NUMBER.unpack(answer)[0]
        return number


def obtain_fork_server() -> ForkServer:
    """Return the server of this process; start a new interpreter if it has no server, or its server has died."""
    with _starting:
        server = _servers.get(os.getpid())
        if server is not None and server.has_ended():
            server.close()
            server = None
        if server is None:
            server = _servers[os.getpid()] = _spawn_server()
    return server


def _spawn_server() -> ForkServer:
    own_end, server_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with server_end:
        end = server_end.fileno()
        start = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve_forks; serve_forks({end})"
        process = subprocess.Popen(
            [sys.executable, "-c", start],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(end,),
            env=os.environ | dict.fromkeys(_THREADS, "1"),
        )
    process.returncode = 0  # ForkServer waits for it
    return ForkServer(own_end, process.pid)


def begin_fork_server() -> None:
    """Begin the server by a fork. This process must have nothing open, and one thread."""
    if sys.platform != "linux":
        return
    own_end, server_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    process = os.fork()
    if process:
        server_end.close()
        _servers[os.getpid()] = ForkServer(own_end, process)
        return
    try:
        end = os.dup2(server_end.fileno(), 3)
        null_device = os.open(os.devnull, os.O_RDWR)
        for standard in range(3):
            os.dup2(null_device, standard)
        os.closerange(4, _MAX_FILES)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        serve_forks(end)
    finally:
        os._exit(0)


@atexit.register
def _close_server() -> None:
    if server := _servers.pop(os.getpid(), None):
        server.close()


def serve_forks(descriptor: int) -> None:
    """Fork children as they are asked for at a socket, until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both processes; the other one decides
    children: set[int] = set()
    with socket.socket(fileno=descriptor) as requests:
        while True:
            message, files, _, _ = socket.recv_fds(requests, _MAX_REQUEST_BYTES, 2)
            if not message:
                break
            kind, content = message[:1], message[1:]
            if kind == _END:
                (child,) = _NUMBER.unpack(content)
                children.discard(child)
                requests.send(_NUMBER.pack(_end_child(child)))
                continue
            for module in content.decode().split():
                with suppress(Exception):  # the child reports the error
                    import_module(module)
            child = _fork_child(*files)
            if child > 0:
                children.add(child)
            for file in files:
                os.close(file)
            requests.send(_NUMBER.pack(child))
    for child in children:
        _end_child(child)


def _end_child(child: int) -> int:
    with suppress(ProcessLookupError, ChildProcessError):
        os.kill(child, signal.SIGKILL)
        return os.waitpid(child, 0)[1]
    return 0


def _fork_child(content: int, outgoing: int) -> int:
    try:
        child = os.fork()
    except OSError as error:
        return -(error.errno or 1)
    if child:
        return child
    try:
        with os.fdopen(os.dup(content), "rb") as file:
            file.seek(0)
            sys.path[:], folder, task = pickle.load(file)
        with suppress(OSError):
            os.chdir(folder)
        work: Callable[[int], None] = pickle.loads(task)
        work(outgoing)
    finally:
        os._exit(0)
