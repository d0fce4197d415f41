"""Fixtures of the tests of ``limits propose``: stored lots, and the command run on them."""

import json

import pytest
from filled_databases import filled as fill
from stored_lots import lot_runs

from cbsr_qa.cli import guarded


@pytest.fixture(scope="session")
def lot_database(tmp_path_factory):
    """Twelve sensors, six of them run twice."""
    path = tmp_path_factory.mktemp("lot") / "runs.db"
    fill(path, lot_runs())
    return path


@pytest.fixture
def database(tmp_path):
    """An empty database, and how to put sensors into it."""
    path = tmp_path / "runs.db"

    def filled(*runs):
        fill(path, runs)
        return path

    return filled


@pytest.fixture
def propose(capsys):
    """Run the command; returns its exit code, what it said, and on stderr."""

    def run(database, *arguments):
        code = guarded(["limits", "propose", "--database", str(database), *map(str, arguments)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


@pytest.fixture
def document(propose):
    """Run the command with ``--json``; the exit code must be 0."""

    def run(database, *arguments):
        code, out, err = propose(database, "--json", *arguments)
        assert code == 0, err
        return json.loads(out)

    return run


@pytest.fixture
def refused(propose):
    """Run the command, which must refuse with one message that holds some words."""

    def run(database, *arguments, said):
        code, out, err = propose(database, "--json", *arguments)
        assert code == 2, (out, err)
        refusal = json.loads(out)["refused"]
        message = f"{refusal['reason']}\n{refusal['remedy']}"
        for words in said:
            assert words in message, message
        assert err.startswith(("cbsr-qa: ", "Usage: "))
        assert "Traceback" not in err
        return message

    return run
