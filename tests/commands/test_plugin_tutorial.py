"""The tutorial on a plugin is typed, edited and read in the order of its page; so are the pages on plugins."""

import re
import shlex
import subprocess
import sys
import tomllib

import pytest
from pages import HOW_TO, TOP, assert_printed, blocks, commands, typed, write_files

pytestmark = pytest.mark.rest

_PAGE = TOP / "docs" / "tutorials" / "your-first-plugin.md"
_FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_tutorial_on_a_plugin_runs_as_printed(tmp_path):
    assert write_files(_PAGE, tmp_path) == ["spread.toml"]
    module = tmp_path / "cbsr-qa-force-spread" / "cbsr_qa_force_spread"
    printed, codes = "", []
    for language, block in _FENCE.findall(_PAGE.read_text()):
        if language == "console":
            done = [_typed(tmp_path, line.removeprefix("$ ")) for line in block.splitlines()]
            codes += [code for code, _ in done if code is not None]
            printed = " ".join(text for _, text in done) + f" {codes[-1] if codes else ''}"
        elif language == "python" and block.startswith('"""'):
            (module / "metric.py").write_text(block)
            exec(block, written := {})
        elif language == "python":
            hooks = module / "__init__.py"
            hooks.write_text("".join(hooks.read_text().splitlines(keepends=True)[:-1]) + block)
        elif language == "text":
            assert_printed(block, printed)
    assert codes == [0, 0, 1, 0, 0, 0]
    (report,) = (tmp_path / "var" / "reports").iterdir()
    assert "force spread" in report.read_text()
    assert len(blocks(_PAGE, "python")) == 2
    (recipe,) = blocks(module.parent / "README.md", "toml")
    assert written["ForceSpread"](**tomllib.loads(recipe)["metrics"]["force-spread"])


@pytest.mark.parametrize("page", ["write-a-driver.md", "write-a-plugin.md"])
def test_the_packages_of_the_how_to_pages_are_made_and_conform(tmp_path, page):
    _, checked = (typed(tmp_path, line) for line in commands(HOW_TO / page))
    assert " checks passed" in checked.stdout


def _typed(folder, line):
    """Type a line; the package is installed into a folder of the test, not beside the program."""
    words = shlex.split(line)
    if words[0] == "cbsr-qa":
        # A fork of the warm process does not read PYTHONPATH again.
        installed = {"fresh": True, "PYTHONPATH": str(folder / "site")} if (folder / "site").exists() else {}
        done = typed(folder, line, check=False, **installed)
        return done.returncode, f"{done.stderr} {done.stdout}"
    if words[:4] == ["python", "-m", "pip", "install"]:
        assert "--no-build-isolation" not in words, "a fresh environment has neither setuptools nor wheel"
        offline = ["--no-index", "--no-build-isolation", "--quiet", "--target", "site"]
        command = [sys.executable, *words[1:], *offline]
        subprocess.run(command, cwd=folder, check=True)
    else:
        assert words[0] in ("export", "mkdir", "cd", "echo"), line
    return None, ""
