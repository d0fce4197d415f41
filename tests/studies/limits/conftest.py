"""Fixtures of the tests of ``limits propose``: stored lots, and the command run on them."""

import json
from functools import partial

import pytest
from filled_databases import filled as fill
from stored_lots import lot_runs


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
def propose(run_command):
    """Run the command on a database; returns its exit code, what it said, and on stderr."""
    return partial(run_command, "limits", "propose", "--database")


@pytest.fixture
def document(printed):
    return partial(printed, "limits", "propose", "--database")


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
