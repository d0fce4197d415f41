"""A database may name any file as an archive: only files in the folder of archives are opened, and within limits."""

import hashlib
import os
import resource
import shutil
import sqlite3
from contextlib import closing

import h5py
import numpy as np
import pytest
from test_store_archives import archived, bits, decided

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.archives import _MAX_ARCHIVE_BYTES
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.untrusted import CONTAINED


@pytest.fixture(scope="module")
def passed(tmp_path_factory):
    """A database with an archived run."""
    folder = tmp_path_factory.mktemp("line")
    with open_store(f"sqlite:///{folder / 'runs.db'}") as store:
        run = decided(store)
        archived(store, run, store.archives.choose_folder(None))
        return folder, run, bits(store, run)


class Line:
    """A folder with a database, and the file of its archived run."""

    def __init__(self, folder, run):
        self.run, self.database = run, folder / "runs.db"
        self.file = folder / "runs-archive" / f"{run}.h5"

    def name(self, place):
        """Let the database name another file, whatever it holds."""
        try:
            held = self.file.read_bytes() if self.file.is_file() else b""
        except OSError:
            held = b""
        row = (str(place), len(held), hashlib.sha256(held).digest())
        with closing(sqlite3.connect(self.database)) as connection, connection:
            connection.execute("UPDATE archives SET file = ?, file_bytes = ?, file_sha256 = ?", row)

    def refused(self, why):
        with open_store(f"sqlite:///{self.database}") as store:
            for read in (store.runs.load, store.archives.unarchive):
                with pytest.raises(StoreError, match=why):
                    read(self.run)


@pytest.fixture
def line(passed, tmp_path):
    folder, run, _ = passed
    shutil.copytree(folder, tmp_path / "line")
    return Line(tmp_path / "line", run)


@pytest.mark.parametrize("place", ["/dev/zero", "/etc/passwd", "../away.h5", "runs-archive/../../away.h5", "a\0b"])
def test_a_place_outside_the_folder_of_archives_is_not_opened(line, place):
    shutil.copy(line.file, line.database.parent.parent / "away.h5")
    line.name(place)
    line.refused("is not below .*line, the folder of archives" if "\0" not in place else "not the path of an archive")


def test_a_link_out_of_the_folder_is_not_followed(line, tmp_path):
    for target in ("/dev/zero", line.file.rename(tmp_path / "away.h5")):
        line.file.symlink_to(target)
        line.refused(f"{target} is not below .*line, the folder of archives")
        line.file.unlink()
    line.file.symlink_to(line.file)
    line.refused("is not the path of an archive|cannot be read")


def test_an_archive_elsewhere_is_read_if_that_folder_is_named(line, tmp_path, monkeypatch, passed):
    (tmp_path / "server").mkdir()
    line.file.rename(tmp_path / "server" / "one.h5")
    with closing(sqlite3.connect(line.database)) as connection, connection:
        connection.execute("UPDATE archives SET file = ?", (str(tmp_path / "server" / "one.h5"),))
    line.refused("name another one with CBSR_QA_ARCHIVE")
    monkeypatch.setenv("CBSR_QA_ARCHIVE", str(tmp_path / "server"))
    with open_store(f"sqlite:///{line.database}") as store:
        assert bits(store, line.run) == passed[2]


def test_a_new_archive_is_not_written_where_it_would_not_be_read(line, tmp_path):
    with open_store(f"sqlite:///{line.database}") as store, pytest.raises(StoreError, match="is not below"):
        store.archives.choose_folder(tmp_path / "elsewhere")


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (os.mkfifo, "it is a named pipe, not a file"),
        (os.mkdir, "it is a folder, not a file"),
        (
            lambda file: file.write_bytes(b"") or os.truncate(file, _MAX_ARCHIVE_BYTES + 1),
            "it is too large: at most 4 GiB are read",
        ),
    ],
)
def test_what_is_no_archive_is_refused_at_once(line, make, why):
    line.file.unlink()
    make(line.file)
    line.refused(f"run {line.run}: its frames are archived in .*cannot be read: {why}")


def test_an_archive_of_another_size_is_not_read(line):
    """A file of 4 GiB takes seconds, and as much memory."""
    written = line.file.stat().st_size
    os.truncate(line.file, _MAX_ARCHIVE_BYTES)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    line.refused(f"which was changed: it has {_MAX_ARCHIVE_BYTES} bytes, {written} were written")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**17  # KiB


def test_a_file_that_is_too_large_for_a_run_is_not_taken_for_its_archive(line):
    with open_store(f"sqlite:///{line.database}") as store:
        store.archives.unarchive(line.run)
        os.truncate(line.file, _MAX_ARCHIVE_BYTES)
        with pytest.raises(StoreError, match=r"it is too large: at most .* are read"):
            archived(store, line.run, line.file.parent)


def _claims(content):
    group = content.create_group("phase-0/1x1-V")
    for name in ("block", "frames"):
        group.create_dataset(name, shape=(2**31,), dtype=np.int64, chunks=(2**16,))


def _external(content):
    group = content.create_group("phase-0/1x1-V")
    group["block"] = h5py.ExternalLink("/etc/passwd", "/")


def _soft(content):
    content["phase-0"] = h5py.SoftLink("/")


def _raw(content):
    group = content.create_group("phase-0/1x1-V")
    group.create_dataset("block", shape=(10,), dtype=np.int64, external=[("/etc/passwd", 0, 80)])


def _zeros(content):
    group = content.create_group("phase-0/1x1-V")
    group["block"], group["frames"] = np.array([0, 1]), np.array([1, 2**28 - 1])
    group.create_dataset("time_s", shape=(2**28,), dtype=float, chunks=(2**16,), compression="gzip")


def _negative(content):
    group = content.create_group("phase-0/1x1-V")
    group["block"], group["frames"] = np.array([0]), np.array([-1])
    group.create_dataset("time_s", shape=(2**28,), dtype=float, chunks=(2**16,), compression="gzip")


def _scalar(content):
    group = content.create_group("phase-0/1x1-V")
    group["block"], group["frames"], group["time_s"] = 0, 1, np.zeros(1)


def _longer(content):
    group = content.create_group("phase-0/1x1-V")
    group["block"], group["frames"], group["time_s"] = np.array([0]), np.array([1]), np.zeros(2)


def _with_their_reasons(*archives):
    return [pytest.param(fill, why, marks=pytest.mark.rest if slow else ()) for fill, why, slow in archives]


@pytest.mark.skipif(not CONTAINED, reason="there are no reading children on this platform")
@pytest.mark.parametrize(
    ("fill", "why"),
    _with_their_reasons(
        (_negative, "the archive cannot be read: blocks of -1 frames in all, and arrays of .268435456", False),
        (_scalar, "the archive cannot be read: blocks of the shape ", False),
        (_longer, r"the archive cannot be read: blocks of 1 frames in all, and arrays of .2\]", False),
        (_claims, r"needs more than 1\.\d GiB of memory", True),
        (_external, "'block' is not content of an archive", True),
        (_soft, "'phase-0' is not content of an archive", True),
        (_raw, "'block' is not content of an archive", True),
        (_zeros, r"needs more than 1\.\d GiB of memory", True),
    ),
)
def test_an_archive_that_contradicts_itself_fills_memory_or_opens_other_files_is_refused(line, fill, why):
    with h5py.File(line.file, "w") as content:
        fill(content)
    line.name(line.file.relative_to(line.database.parent))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    line.refused(why)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**17  # KiB
