"""Files of unknown origin are opened only if they are files, and of a limited size."""

import os
import socket
import threading
from pathlib import Path

import pytest

from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.system.foreign import UnfitFileError, check_regular, open_foreign, read_foreign, size_in_words
from cbsr_qa.system.untrusted import read_untrusted

OPEN = Path("/proc/self/fd")


def _pipe(path):
    os.mkfifo(path)


def _socket(path):
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))


@pytest.fixture
def beside(tmp_path, monkeypatch):
    """A folder whose paths are short enough for a socket."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (_pipe, "a named pipe"),
        (_socket, "a socket"),
        (os.mkdir, "a folder"),
        (lambda path: Path(path).symlink_to("/dev/zero"), "a device"),
        (lambda path: Path(path).symlink_to("/dev/tty"), "a device"),
    ],
)
@pytest.mark.usefixtures("beside")
def test_what_is_no_file_is_refused_at_once(tmp_path, make, found):
    make("given")
    path = tmp_path / "given"
    for opening in (open_foreign, check_regular, lambda path: read_foreign(path, 100)):
        with pytest.raises(UnfitFileError, match=f"it is {found}, not a file"):
            opening(path)
    with pytest.raises(RecordingError, match=f"given cannot be read: it is {found}, not a file"):
        read_untrusted(path, path.read_bytes, refusal=RecordingError)


@pytest.mark.skipif(not OPEN.exists(), reason="the kernel does not list open files here")
def test_a_pipe_that_takes_the_place_of_a_file_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "given"
    path.write_bytes(b"content")
    regular = path.stat()
    path.unlink()
    os.mkfifo(path)
    monkeypatch.setattr(type(path), "stat", lambda self, **_: regular)
    opened = []
    before = len(list(OPEN.iterdir()))

    def opening():
        with pytest.raises(UnfitFileError, match="a named pipe"):
            open_foreign(path)
        opened.append(path)

    thread = threading.Thread(target=opening, daemon=True)
    thread.start()
    thread.join(10)
    assert opened == [path]
    assert len(list(OPEN.iterdir())) == before


def test_a_file_is_read_to_its_limit_and_no_further(tmp_path):
    path = tmp_path / "given"
    path.write_bytes(b"0123456789")
    assert read_foreign(path, 10) == b"0123456789"
    with pytest.raises(UnfitFileError, match="it is too large: at most 9 bytes are read"):
        read_foreign(path, 9)
    with pytest.raises(FileNotFoundError):
        read_foreign(tmp_path / "none", 9)
    (tmp_path / "link").symlink_to(path)
    with open_foreign(tmp_path / "link") as file:
        assert not os.get_inheritable(file.fileno())
        assert file.read() == b"0123456789"


@pytest.mark.skipif(not OPEN.exists(), reason="the kernel shows no files here")
@pytest.mark.parametrize("name", ["/proc/self/maps", "/proc/self/mem", "/proc/kmsg", "/sys/kernel/mm/ksm/run"])
def test_a_file_of_the_kernel_is_refused_as_what_it_is(tmp_path, name):
    if not Path(name).exists():
        pytest.skip(f"there is no {name} here")
    (tmp_path / "link").symlink_to(name)
    for opening in (open_foreign, check_regular, lambda path: read_foreign(path, 100)):
        with pytest.raises(UnfitFileError, match="the kernel makes it up, it is not a file on a disk"):
            opening(tmp_path / "link")


def test_an_empty_file_is_a_file(tmp_path):
    (tmp_path / "given").touch()
    assert read_foreign(tmp_path / "given", 100) == b""


@pytest.mark.parametrize(
    ("size_bytes", "words"),
    [
        (9, "9 bytes"),
        (2**16, "64 KiB"),
        (3 * 2**19, "1.5 MiB"),
        (2**29, "512 MiB"),
        (2 * 10**8, "200 MB"),
        (2**32, "4 GiB"),
    ],
)
def test_a_size_is_said_in_its_largest_unit(size_bytes, words):
    assert size_in_words(size_bytes) == words
