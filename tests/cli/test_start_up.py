"""What commands load before they do anything: nothing that they do not use."""

import json
import os
import subprocess
import sys

import pytest
from one_press import one_press_recipe

RECIPE = one_press_recipe("centre-of-mass-error", "force-error")
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
        (["plugins", "list"], DRAWING | {"scipy", "sqlalchemy", "cbsr_qa.plugin.api", "cbsr_qa.plugin.options"}),
        pytest.param(["plugins", "show", "gauss-newton-noser"], DRAWING | {"sqlalchemy"}, marks=pytest.mark.rest),
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


#: Packages of other commands.
FOREIGN = ("studies", "web", "interface", "testing", "app.export", "app.stream", "app.shift", "app.reanalyse")
#: Of the project, plugins not counted.
MOST_MODULES = 356


@pytest.mark.rest  # the same rule as above, of a whole run of the installed program
def test_a_run_loads_no_package_of_another_command(tmp_path):
    (tmp_path / "one-press.toml").write_text(RECIPE)
    run = ["run", "--station", "simulated", "--recipe", "one-press.toml", "--serial", "S-1"]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *run],
        cwd=tmp_path,
        env=os.environ | {"CBSR_QA_VAR": "var"},
        capture_output=True,
        text=True,
        check=True,
    )
    code, modules = json.loads(done.stdout)
    assert code == 0, done.stderr
    ours = [module for module in modules if module.split(".")[0] == "cbsr_qa"]
    foreign = tuple(f"cbsr_qa.{package}" for package in FOREIGN)
    assert [module for module in ours if module.startswith(foreign)] == []
    assert len(ours) <= MOST_MODULES
