"""Writers of other people that fail: nothing is left behind, and the format to blame is named."""

from pathlib import Path

import pytest
from written_scenes import made_up

from cbsr_qa.domain.errors import PluginError, RefusedError
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.simulate.recording import RecordedScene
from cbsr_qa.studies.scenes.files import Target, check_targets, write_all

RECORDED = RecordedScene(*made_up(3), ())


def target(folder, name, write):
    writer = type("Theirs", (), {"write": lambda self, path, recording, transcript: write(path)})()
    return Target(name, folder / f"{name}.txt", writer)


def good(path):
    path.write_text("whole")
    return ("a note",)


def half_and(error):
    def write(path):
        path.write_text("half")
        raise error

    return write


def returning(value):
    def write(path):
        path.write_text("whole")
        return value

    return write


def test_a_file_that_came_while_the_scene_was_simulated_is_kept(tmp_path):
    (tmp_path / "second.txt").write_text("somebody's")
    targets = (target(tmp_path, "first", good), target(tmp_path, "second", good))
    with pytest.raises(RefusedError, match=r"second\.txt was created in the meantime"):
        write_all(RECORDED, targets)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("second.txt", "somebody's")]


@pytest.mark.parametrize("name", ["mine.csv", "mine.CSV", "mine.mat"])
def test_our_own_format_is_not_written_under_the_name_of_another(tmp_path, name):
    with pytest.raises(RefusedError, match="must be an HDF5 file") as refused:
        check_targets("mine", 7, tmp_path / name, (), discover())
    assert str(tmp_path / "mine.h5") in refused.value.remedy
    for allowed in ("mine.h5", "mine.hdf5", "mine"):
        (one,) = check_targets("mine", 7, tmp_path / allowed, (), discover())
        assert one.path.name == allowed


def test_what_writers_say_is_handed_on(tmp_path):
    (file,) = write_all(RECORDED, (target(tmp_path, "theirs", good),))
    assert (file.format, Path(file.path).read_text(), file.notes) == ("theirs", "whole", ("a note",))


@pytest.mark.parametrize(
    ("write", "error", "why"),
    [
        (half_and(RuntimeError("their slip")), PluginError, "format 'theirs' failed .* RuntimeError: their slip"),
        (half_and(MemoryError()), PluginError, "format 'theirs' failed .* MemoryError"),
        (returning(None), PluginError, "format 'theirs' failed .* NoneType instead of a tuple of texts"),
        (returning("note"), PluginError, "format 'theirs' failed .* str instead of a tuple of texts"),
        (returning((1,)), PluginError, "format 'theirs' failed .* tuple instead of a tuple of texts"),
        (lambda path: (), PluginError, "format 'theirs' failed .* there is no "),
        (half_and(OSError(28, "No space left on device")), RefusedError, "No space left"),
        (half_and(RefusedError("too many frames")), RefusedError, "too many frames"),
        (half_and(KeyboardInterrupt()), KeyboardInterrupt, None),
    ],
)
def test_of_a_writer_that_fails_no_file_is_left(tmp_path, write, error, why):
    with pytest.raises(error, match=why):
        write_all(RECORDED, (target(tmp_path, "first", good), target(tmp_path, "theirs", write)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["", "a/../b", "..", "\0", "x" * 300])
def test_a_format_that_is_no_part_of_a_files_name_is_unknown(tmp_path, name):
    with pytest.raises(PluginError, match="no recording plugin named"):
        check_targets("mine", 7, tmp_path / "x.h5", (name,), discover())
