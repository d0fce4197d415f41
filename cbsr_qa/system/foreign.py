"""The one way to open a file that this program did not write itself: a regular file, and not too large a one.

Opening a named pipe waits for its writer, a device may have no end, and a link may lead to either. A name may stand
for another file by the time it is opened, so the open file itself is checked. ``tests/test_opening.py`` refuses any
other way of opening in the program.
"""

import errno
import os
import stat
from functools import cache
from io import BufferedReader
from pathlib import Path
from typing import Final

#: Largest file that is opened [B]: more than any recording, such as board text of two days.
LARGEST_FILE: Final = 2**32
#: Flags of opening: it does not wait, takes no controlling terminal, and other programs do not inherit it.
_FLAGS: Final = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_NOCTTY", 0)
    | getattr(os, "O_BINARY", 0)
)
_KINDS: Final = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFDIR: "a folder",
}

#: File systems whose files look regular, and are not (proc(5), sysfs(5), tracefs).
_KERNEL: Final = frozenset(
    {"proc", "sysfs", "debugfs", "tracefs", "securityfs", "cgroup", "cgroup2", "configfs", "bpf"}
)


class UnfitFileError(OSError):
    """A file of an unfit kind or size, which is not opened; ``strerror`` states the reason without the name."""


def open_foreign(path: Path, most_bytes: int = LARGEST_FILE) -> BufferedReader:
    """Open a file of unknown origin for reading.

    OSError if it cannot be opened; UnfitFileError, which is one, if it is a pipe, device, socket or folder, or has
    more than ``most_bytes``.
    """
    check_regular(path)  # opening some devices does something: a tape is rewound
    file = os.open(path, _FLAGS)
    try:
        status = os.fstat(file)
        check_status(path, status)
        if status.st_size > most_bytes:
            raise _refuse_size(path, most_bytes)
        return os.fdopen(file, "rb")
    except BaseException:
        os.close(file)
        raise


def read_foreign(path: Path, most_bytes: int) -> bytes:
    """Return the bytes of a file of unknown origin. Raises what :func:`open_foreign` raises."""
    with open_foreign(path, most_bytes) as file:
        data = file.read(most_bytes + 1) or b""  # files of the kernel have no size, and may answer None
    if len(data) > most_bytes:
        raise _refuse_size(path, most_bytes)
    return data


def check_regular(path: Path) -> None:
    """Check a file that a library will open by its name. UnfitFileError if it is not regular; OSError if missing."""
    check_status(path, path.stat())


def check_status(path: Path, status: os.stat_result) -> None:
    """Check the status of an open file. UnfitFileError if it is a pipe, device, socket, folder or the kernel's."""
    kind = stat.S_IFMT(status.st_mode)
    if kind != stat.S_IFREG:
        kind_name = _KINDS.get(kind, "something else")
        raise UnfitFileError(errno.EINVAL, f"it is {kind_name}, not a file", str(path))
    if getattr(status, "st_blocks", 1) == 0 and _is_of_kernel(status.st_dev):
        raise UnfitFileError(errno.EINVAL, "the kernel makes it up, it is not a file on a disk", str(path))


@cache
def _is_of_kernel(device: int) -> bool:
    """Whether the kernel makes up the files of a device: reading one may wait for ever, or show memory."""
    number = f"{os.major(device)}:{os.minor(device)}"
    try:
        mounts = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:  # another system
        return False
    for mount in mounts.splitlines():  # "36 35 0:5 / /proc rw - proc proc rw", see proc_pid_mountinfo(5)
        mount_fields, _, file_system = mount.partition(" - ")
        if mount_fields.split()[2:3] == [number] and file_system.split()[:1] and file_system.split()[0] in _KERNEL:
            return True
    return False


def size_in_words(size_bytes: int) -> str:
    """Return a size in the largest unit that it fills: ``4 GiB``, ``1.5 MiB``, ``512 bytes``; or whole ``1 MB``."""
    if size_bytes and size_bytes % 10**6 == 0:
        return f"{size_bytes // 10**6} MB"
    for unit, name in ((2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB")):
        if size_bytes >= unit:
            return f"{size_bytes / unit:.3g} {name}"
    return f"{size_bytes} bytes"


def _refuse_size(path: Path, most_bytes: int) -> UnfitFileError:
    return UnfitFileError(errno.EFBIG, f"it is too large: at most {size_in_words(most_bytes)} are read", str(path))
