"""What people type: serial numbers, batches, operators, folders, databases; and where a key stands in a file."""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from cbsr_qa.config.paths import calibrations_folder, database_url, reports_folder, var_folder, writable_folder
from cbsr_qa.config.serials import validate_batch, validate_operator, validate_serial
from cbsr_qa.config.text import line_of
from cbsr_qa.domain.errors import ConfigError

HOSTILE = [
    "",
    "../../x",
    "<script>",
    "a" * 5000,
    "a\0b",
    "a\nb",
    "\x1b[31m",
    "-x",
    ".hidden",
    "_x",
    "a b",
    "ä",
    "a/b",
    "٣",
]


@pytest.mark.parametrize("text", ["A", "DEMO-001", "2026.11_a-b", "9", "x" * 64, "a..b"])
def test_serial_numbers_that_are_fit_for_use_come_back_unchanged(text):
    assert validate_serial(text) == text
    assert validate_batch(text) == text


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_serial_numbers_are_refused_shortly_and_without_repeating_control_characters(text):
    with pytest.raises(ConfigError) as caught:
        validate_serial(text)
    message = str(caught.value)
    assert caught.value.exit_code == 2
    assert len(message) < 300
    assert all(character.isprintable() or character == "\n" for character in message)
    assert "64 characters" in message


@pytest.mark.rest
@given(st.text())
def test_whatever_is_accepted_is_safe_as_the_name_of_a_file(text):
    try:
        serial = validate_serial(text)
    except ConfigError:
        return
    assert serial == text
    assert Path(f"{serial}-x.h5").name == f"{serial}-x.h5"
    assert serial.isascii()
    assert serial[0].isalnum()
    assert 1 <= len(serial) <= 64


def test_a_batch_may_be_left_out():
    assert validate_batch("") == ""


@pytest.mark.parametrize("text", ["", "Zoë Ōtani", "O'Brien-Smith", "李小龍", "A. B. 2", "नेहा"])
def test_operators_may_have_any_name(text):
    assert validate_operator(text) == text


@pytest.mark.parametrize("text", ["<b>", " x", "x ", "a  b", "a\tb", "a" * 65, "a;b", "\u202eabc"])
def test_operators_are_not_markup_or_control_characters(text):
    with pytest.raises(ConfigError):
        validate_operator(text)


def test_everything_is_written_below_one_folder():
    assert var_folder({}) == Path("var")
    here = {"CBSR_QA_VAR": "/data/qa"}
    assert (reports_folder(here), calibrations_folder(here)) == (
        Path("/data/qa/reports"),
        Path("/data/qa/calibrations"),
    )
    assert database_url(None, here) == "sqlite:////data/qa/cbsr-qa.db"
    assert database_url(None, {}) == "sqlite:///var/cbsr-qa.db"


def test_the_option_wins_over_the_environment_and_a_path_is_sqlite():
    environment = {"CBSR_QA_DATABASE": "postgresql://x/y", "CBSR_QA_VAR": "/data"}
    assert database_url(None, environment) == "postgresql://x/y"
    assert database_url("/tmp/a.db", environment) == "sqlite:////tmp/a.db"
    assert database_url("sqlite:///b.db", environment) == "sqlite:///b.db"


def test_a_folder_that_can_be_written_to_is_made_and_left_empty(tmp_path):
    folder = writable_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot be written to") as caught:
        writable_folder(tmp_path / "file" / "reports")
    assert "CBSR_QA_VAR" in caught.value.remedy


TEXT = '''# first
[station]
name = "x"          # a comment with [brackets]
note = """
[not.a.table]
name = "inside a string"
"""

[instruments.bench]
driver = "d"
"odd key" = 1

[[phases]]
name = "a"
[[phases]]
name = "b"
deep.er = 2

[phases.options]
k = 1
'''


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("station",), 2),
        (("station", "name"), 3),
        (("station", "missing"), 2),
        (("instruments",), 9),
        (("instruments", "bench", "driver"), 10),
        (("instruments", "bench", "odd key"), 11),
        (("phases", 0, "name"), 14),
        (("phases", 1, "name"), 16),
        (("phases", 1, "deep", "er"), 17),
        (("phases", 1, "options", "k"), 20),
        (("nowhere",), None),
        ((), None),
    ],
)
def test_lines_of_keys(path, line):
    assert line_of(TEXT, path) == line


def test_typed_checks_and_database_commands_import_nothing_heavy():
    code = (
        "import sys, cbsr_qa.config.serials, cbsr_qa.config.paths, cbsr_qa.cli.db;"
        "print([m for m in ('pydantic', 'sqlalchemy', 'alembic', 'numpy', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
