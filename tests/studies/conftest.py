"""Commands of studies, run in this process."""

import json

import pytest

from cbsr_qa.cli.main import run_guarded


@pytest.fixture
def run_command(capsys):
    """Run a command; returns its exit code, what it wrote to stdout, and to stderr."""

    def run(*arguments):
        code = run_guarded([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def run_in_words(run_command):
    """The same with both texts on one line each, whatever their layout."""

    def run(*arguments):
        code, *texts = run_command(*arguments)
        return code, *(" ".join(text.split()) for text in texts)

    return run


@pytest.fixture
def printed(run_command):
    """Run a command that must end with 0; returns the document it prints."""

    def run(*arguments):
        code, out, err = run_command(*arguments, "--json")
        assert code == 0, err
        return json.loads(out)

    return run


@pytest.fixture
def refusal(run_in_words):
    """Run a command that must be refused; returns its message on one line."""

    def run(*arguments):
        code, _, message = run_in_words(*arguments)
        assert code == 2, message
        assert "Traceback" not in message
        return message

    return run
