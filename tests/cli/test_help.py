"""Help in words: what is typed for a value, never a type of Python; one way to name a station."""

import re
import subprocess
import sys

import pytest

from cbsr_qa.cli.command import commands
from cbsr_qa.cli.main import run_guarded

WORDS = [command.words for command in commands()]


@pytest.mark.parametrize("words", ["", *sorted({words.partition(" ")[0] for words in WORDS} | set(WORDS))])
def test_help_shows_no_types_of_python_and_no_markup(capsys, words):
    assert run_guarded([*words.split(), "--help"]) == 0
    out = capsys.readouterr().out
    assert "Usage" in out
    assert not re.search(r"<\w+(\[\w+\])?>|<class|\bstr\b|\bfloat\b|list\[|range\b.*\[|%Y|x>=|<=x|`", out), out


def test_a_module_named_as_a_word_declares_all_commands_that_begin_with_it():
    """A command line imports no other one."""
    declared = {command.words: command.run.__module__.removeprefix("cbsr_qa.cli.") for command in commands()}
    alone = {words.partition(" ")[0] for words, module in declared.items() if words.partition(" ")[0] == module}
    assert "station" in alone
    assert {words: module for words, module in declared.items() if words.partition(" ")[0] in alone - {module}} == {}


def test_help_lists_run_first_and_then_what_follows_a_run(capsys):
    assert run_guarded(["--help"]) == 0
    listed = re.findall(r"^│ (run|report|export|analyse|schema) ", capsys.readouterr().out, re.MULTILINE)
    assert listed == ["run", "report", "export", "analyse", "schema"]


def test_a_shell_completes_words(capsys, monkeypatch):
    monkeypatch.setenv("_CBSR_QA_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", "cbsr-qa calibration a")
    monkeypatch.setenv("COMP_CWORD", "2")
    assert run_guarded([]) == 0
    assert capsys.readouterr() == ("apply\n", "")


def test_every_option_and_argument_has_a_description():
    from typer import main as typer_main

    from cbsr_qa.cli.main import app

    def all_of(command):
        for below in getattr(command, "commands", {}).values():
            yield from all_of(below)
        yield command

    for command in all_of(typer_main.get_command(app)):
        for parameter in command.params:
            assert parameter.help, f"{command.name} {parameter.name}"


def test_a_run_and_a_check_name_their_station_alike(capsys):
    for named in (("--station", "nowhere"), ("nowhere",)):
        assert run_guarded(["station", "check", *named]) == 2
        assert "no station named 'nowhere'" in capsys.readouterr().err
    assert run_guarded(["station", "check", "simulated", "--station", "simulated"]) == 2
    assert "named twice" in capsys.readouterr().err
    assert run_guarded(["station", "check"]) == 2
    assert "Missing option '--station'" in capsys.readouterr().err


def test_help_on_benchmarks_lists_its_parts():
    import subprocess
    import sys

    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--help"], capture_output=True, text=True, check=True, timeout=60
    )
    assert re.search(r"^  fleet +Batches compared", done.stdout, re.M)
    assert "python -m benchmarks.chart_alarms" in done.stdout


def test_help_and_version_load_no_heavy_library():
    """Each takes longer than all of the command line: help and version answer at once."""
    loaded = "import sys, cbsr_qa.cli.main; print(*sys.modules)"
    modules = set(
        subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True).stdout.split()
    )
    assert not modules & {"numpy", "scipy", "pydantic", "sqlalchemy", "jinja2", "pluggy", "h5py"}
