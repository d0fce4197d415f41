"""What commands load before they do anything: nothing that they do not use."""

import json
import subprocess
import sys

import pytest

#: Runs one command in this process and prints which modules it has loaded.
SCRIPT = """
import contextlib, io, json, sys
from cbsr_qa.cli.main import run_guarded

with contextlib.redirect_stdout(io.StringIO()):
    code = run_guarded(sys.argv[1:])
print(json.dumps([code, sorted(sys.modules)]))
"""
DRAWING = {"matplotlib", "jinja2"}
NUMERICS = {"numpy", "scipy", "pydantic", "sqlalchemy"}


@pytest.mark.parametrize(
    ("command", "unused"),
    [
        (["--version"], DRAWING | NUMERICS),
        (["--help"], DRAWING | NUMERICS),
        (["plugins", "list"], DRAWING | {"scipy", "sqlalchemy", "cbsr_qa.plugin.offer", "cbsr_qa.plugin.options"}),
        (["plugins", "show", "gauss-newton-noser"], DRAWING | {"sqlalchemy"}),
        (["db", "status"], DRAWING | {"scipy"}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_command_loads_nothing_that_it_does_not_use(command, unused, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *command], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    code, modules = json.loads(done.stdout)
    assert code == 0, done.stderr
    assert unused & set(modules) == set()
