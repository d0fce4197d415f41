"""Every property of the other tests, on examples that are drawn at random: ten times as many as are stated."""

import os
import subprocess
import sys

from pages import TOP


def test_every_property_holds_for_examples_drawn_at_random():
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "hypothesis", "tests"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    done = subprocess.run(
        command, cwd=TOP, env={**environment, "CBSR_QA_TIER": "soak"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-2000:]
