"""Changed code is what it is said to be, whether its module is loaded already or not."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mutant_code import VARIABLE, functions, sites

_SOURCE = '''
from functools import cached_property, lru_cache

@lru_cache
def least(a: int, b: int = 3) -> int:
    """Return 7 of them."""
    if not a < b and a + 1.5 > b:
        raise ValueError(f"{a + 1} of {b}")
    return a if a else -2

class Box:
    @cached_property
    def size(self) -> int:
        return 2 * least(1, 5)

    def __repr__(self) -> str:
        return "box" * 2
'''


def _changes(name):
    return [f"{one.before} -> {one.after}" for one in sites(dict(functions(ast.parse(_SOURCE)))[name])]


def test_what_decides_or_computes_is_changed_and_words_and_types_are_not():
    assert _changes("least") == [
        "not a < b and a + 1.5 > b -> not a < b or a + 1.5 > b",
        "not a < b -> a < b",
        "a < b -> a <= b",
        "a < b -> a >= b",
        "a + 1.5 > b -> a + 1.5 >= b",
        "a + 1.5 > b -> a + 1.5 <= b",
        "a + 1.5 -> a - 1.5",
        "1.5 -> 2.25",
        "a -> not a",
        "2 -> 3",
    ]
    assert _changes("Box.__repr__") == []


_SHOW = "print(boxes.least(0), boxes.Box().size)"
_INSTALL = "import mutant_code; mutant_code.install(); "


@pytest.mark.parametrize("script", [f"{_INSTALL}import boxes; {_SHOW}", f"import boxes; {_INSTALL}{_SHOW}"])
@pytest.mark.parametrize(
    ("name", "number", "printed"),
    [("least", 9, "-3 2"), ("least", 8, "0 -4"), ("Box.size", 0, "-2 2.0"), ("Box.size", 3, "-2 2")],
)
def test_a_process_that_is_told_so_runs_changed_code(tmp_path, script, name, number, printed):
    module = tmp_path / "boxes.py"
    module.write_text(_SOURCE)
    plan = tmp_path / "plan.json"
    plan.write_text(json.dumps({"modules": {str(module): [[name, number, 0]]}}))
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parent)])
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, VARIABLE: str(plan), "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == printed


def test_a_statement_that_would_be_changed_says_which_test_reaches_it(tmp_path):
    module = tmp_path / "boxes.py"
    module.write_text(_SOURCE)
    plan = tmp_path / "plan.json"
    told = {"modules": {str(module): [["least", 0, 4], ["Box.size", 0, 5]]}, "reached": str(tmp_path)}
    plan.write_text(json.dumps(told))
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parent)])
    subprocess.run(
        [sys.executable, "-c", f"{_INSTALL}import boxes; boxes.least(0)"],
        env={**os.environ, VARIABLE: str(plan), "PYTHONPATH": path, "PYTEST_CURRENT_TEST": "test_a (call)"},
        check=True,
    )
    (written,) = tmp_path.glob("*.reached")
    assert written.read_text() == "4\ttest_a\n"
