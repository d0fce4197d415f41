"""How to test more sensors an hour: the page's commands, typed as printed, on the demonstration's batch."""

import json
import os
import subprocess
import sys

import pytest
from command import cbsr_qa
from pages import HOW_TO, commands, typed

pytestmark = pytest.mark.rest

PAGE = HOW_TO / "test-more-sensors-an-hour.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with what ``make fleet-demo`` leaves of its batch."""
    folder = tmp_path_factory.mktemp("batch")
    script = "from cbsr_qa.app.demo_batch import build_batch; build_batch()"
    subprocess.run([sys.executable, "-c", script], cwd=folder, env=os.environ | {"CBSR_QA_VAR": "var"}, check=True)
    return folder


def test_the_page_runs_as_printed(folder):
    printed = [typed(folder, line).stdout for line in commands(PAGE)]
    stored, dry, batch, run = printed
    assert "places" in stored
    assert (folder / "fewer.toml").is_file()
    assert "on a usual sheet" in dry
    assert "is common to the batch" in batch
    assert (folder / "batch.html").is_file()
    assert "chosen one by one; the target was reached" in run
    (kept,) = (folder / "var" / "batches").glob("41-*.json")
    database = str(folder / "var" / "fleet-demo-batch" / "runs.db")
    found = json.loads(cbsr_qa(folder, "batch", "model", "--batch", "41", "--database", database, "--json").stdout)
    assert found["rho"]["low"] <= 0.9 <= found["rho"]["high"]
    assert json.loads(kept.read_text())["digest"] != found["digest"]  # a sensor more has passed since
