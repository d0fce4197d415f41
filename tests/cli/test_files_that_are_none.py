"""A pipe without a writer, or a device without an end, in place of any file that a command reads: refused at once."""

import os
import signal
from pathlib import Path

import pytest
from calibration_samples import sample_calibration
from test_recording_file import sample

from cbsr_qa.analysis.recording_files import write_recording
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.system.files import FileLock, holder
from cbsr_qa.system.secret import secret_of

_PATIENCE_S = 30

#: FILE is what is none; CAL a sound calibration, REC a recording, KEY a private key, CSV and PAIRS tables, ABSENT a
#: file that is to be written.
_LINES = [
    "analyse FILE",
    "analyse --sensor-type FILE.toml REC",
    "analyse --reference FILE REC",
    "calibrate CSV --presses FILE --pattern CSV --differences --sensor-type disc-100mm --to ABSENT",
    "calibrate FILE --presses CSV --pattern PAIRS --differences --sensor-type disc-100mm --to ABSENT",
    "calibrate CSV --presses CSV --pattern FILE --differences --sensor-type disc-100mm --to ABSENT",
    "calibrate CSV --presses CSV --pattern PAIRS --rest FILE --sensor-type disc-100mm --to ABSENT",
    "calibration apply FILE CAL",
    "calibration apply CAL FILE",
    "calibration apply CAL CAL --public-key FILE",
    "calibration export FILE --output ABSENT.json",
    "calibration export FILE.json --output ABSENT.h5",
    "calibration show FILE",
    "calibration sign CAL --key FILE",
    "calibration sign FILE --key KEY",
    "calibration verify CAL --public-key FILE",
    "calibration verify FILE",
    "db backup --database FILE ABSENT",
    "db check --database FILE",
    "db restore --database ABSENT FILE",
    "db status --database FILE",
    "frontier --recipe FILE.toml",
    "gauge FILE.toml",
    "limits propose --serials FILE --batch B",
    "run --serial S-1 --station FILE.toml --recipe nine-locations",
    "run --serial S-1 --station simulated --recipe FILE.toml",
    "runs --database FILE",
    "serve --station simulated --certificate FILE --key FILE --host 192.0.2.1",
    "serve --station simulated --token-file FILE",
    "stream FILE",
]


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    folder = tmp_path_factory.mktemp("given")
    write_calibration(folder / "c.h5", sample_calibration())
    write_recording(folder / "r.h5", sample())
    new_key(folder / "key")
    (folder / "t.csv").write_text("x_mm,y_mm\n1,2\n3,4\n")
    (folder / "pairs.csv").write_text("source,sink,plus,minus\n0,1,2,3\n0,1,3,4\n")
    return {name: str(folder / file) for name, file in _GIVEN.items()}


_GIVEN = {"CAL": "c.h5", "REC": "r.h5", "KEY": "key", "CSV": "t.csv", "PAIRS": "pairs.csv"}


@pytest.fixture
def patience():
    """The end of this process, should a command wait for a writer or read on."""
    signal.alarm(_PATIENCE_S)
    yield
    signal.alarm(0)


_PIPE = "it is a named pipe, not a file"
#: What is said of each, and how it is made.
_KINDS = {
    _PIPE: os.mkfifo,
    "it is a device, not a file": lambda path: Path(path).symlink_to("/dev/zero"),
    "the kernel makes it up, it is not a file on a disk": lambda path: Path(path).symlink_to("/proc/kmsg"),
}
#: A pipe in place of each file, and each kind in place of a recording, a calibration, a database and a recipe.
_FIRST = ("analyse FILE", "calibration show FILE", "db check --database FILE", "gauge FILE.toml")
_CASES = [
    pytest.param(line, what, marks=() if what == _PIPE or line in _FIRST else pytest.mark.rest)
    for line in _LINES
    for what in _KINDS
]


@pytest.mark.usefixtures("patience")
@pytest.mark.parametrize(("line", "what"), _CASES)
def test_what_is_no_file_is_refused_at_once(line, what, given, tmp_path, monkeypatch, capfd):
    if "kernel" in what and not Path("/proc/kmsg").exists():
        pytest.skip("the kernel shows no files here")
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    names = dict(given, FILE=str(tmp_path / "none"), ABSENT=str(tmp_path / "absent"))
    words = [_named(word, names) for word in line.split()]
    for word in words:
        if word.startswith(names["FILE"]) and not Path(word).is_symlink() and not Path(word).exists():
            _KINDS[what](word)
    assert run_guarded(words) == 2
    assert what in capfd.readouterr().err


def _named(word, names):
    stem, dot, suffix = word.partition(".")
    return names.get(stem, stem) + dot + suffix


@pytest.mark.usefixtures("patience")
@pytest.mark.parametrize("command", ["db status", "db upgrade", "db check", "runs"])
def test_a_link_to_no_database_makes_none(command, tmp_path, capfd):
    (tmp_path / "runs.db").symlink_to(tmp_path / "away" / "target.db")
    (tmp_path / "away").mkdir()
    assert run_guarded([*command.split(), "--database", str(tmp_path / "runs.db")]) == 2
    said = " ".join(capfd.readouterr().err.split())
    assert f"runs.db is a link that leads to {tmp_path / 'away' / 'target.db'}, which does not exist" in said
    assert not list((tmp_path / "away").iterdir())


@pytest.mark.parametrize("command", ["db status", "runs"])
def test_a_database_without_a_name_is_not_the_default(command, capfd):
    assert run_guarded([*command.split(), "--database", ""]) == 2
    assert "--database is empty" in capfd.readouterr().err


def test_a_link_in_a_circle_is_no_database(tmp_path, capfd):
    (tmp_path / "runs.db").symlink_to("runs.db")
    assert run_guarded(["runs", "--database", str(tmp_path / "runs.db")]) == 2
    assert "runs.db is a link that leads back to itself" in capfd.readouterr().err


@pytest.mark.parametrize("make", [os.mkfifo, Path.touch, lambda path: path.symlink_to("gone")])
def test_a_database_is_below_folders(make, tmp_path, monkeypatch, capfd):
    make(tmp_path / "var")
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    assert run_guarded(["db", "status"]) == 2
    assert f"{tmp_path / 'var'} is not a folder" in capfd.readouterr().err


@pytest.mark.usefixtures("patience")
@pytest.mark.parametrize("suffix", ["-wal", "-journal", "-shm"])
def test_a_database_with_a_pipe_for_a_log_is_refused(suffix, tmp_path, capfd):
    (tmp_path / "runs.db").touch()
    os.mkfifo(tmp_path / f"runs.db{suffix}")
    assert run_guarded(["db", "check", "--database", str(tmp_path / "runs.db")]) == 2
    assert f"runs.db{suffix}: it is a named pipe, not a file" in capfd.readouterr().err


@pytest.mark.usefixtures("patience")
def test_a_secret_is_read_from_a_file_only(tmp_path):
    os.mkfifo(tmp_path / "secret")
    with pytest.raises(ConfigError, match="that SECRET names cannot be read: it is a named pipe, not a file"):
        secret_of("SECRET", remedy="", environment={"SECRET": f"@{tmp_path / 'secret'}"})


@pytest.mark.usefixtures("patience")
def test_a_pipe_in_the_place_of_a_lock_is_held_by_nobody_and_stays(tmp_path):
    os.mkfifo(tmp_path / "lock")
    assert holder(tmp_path / "lock") is None
    with pytest.raises(OSError, match="it is a named pipe, not a file"):
        FileLock(tmp_path / "lock", b"me")
    assert (tmp_path / "lock").is_fifo()
