"""A tutorial is typed, edited and read in the order of its page, as a newcomer would."""

import html
import re

import pytest
from pages import TOP, assert_printed, typed, write_files

pytestmark = pytest.mark.rest

_FIRST = TOP / "docs" / "tutorials" / "your-first-recipe.md"
_BENCH = _FIRST.with_name("your-own-bench.md")
_FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_first_tutorial_runs_as_printed(tmp_path):
    assert _followed(_FIRST, tmp_path, edited="first.toml") == [0, 0, 1, 2, 0, 0, 0]

    _, failed, _ = (_words(report) for report in sorted((tmp_path / "var" / "reports").iterdir()))
    (quoted,) = re.findall(r"^> (.*)$", _FIRST.read_text(), re.MULTILINE)
    assert f"Limits and measurements {quoted}" in failed
    assert len(list((tmp_path / "var" / "calibrations").iterdir())) == 2


def test_the_tutorial_on_a_bench_runs_as_printed(tmp_path):
    assert _followed(_BENCH, tmp_path, edited="bench.toml") == [0, 2, 0, 3, 0]


def _followed(page, folder, *, edited):
    """Do what a tutorial says, whose later snippets of TOML change one file; returns the exit codes."""
    files, codes, printed = write_files(page, folder), [], ""
    changed = folder / edited
    assert edited in files
    for language, block in _FENCE.findall(page.read_text()):
        if language == "toml" and block not in [(folder / name).read_text() for name in files]:
            changed.write_text(_edited(changed.read_text(), block))
        elif language == "console":
            printed = _typed_in_turn(folder, block, codes)
        elif language != "toml":
            assert language == "text"
            assert_printed(block, printed)
    return codes


def _edited(text, block):
    """Return a file after an edit: one line takes the place of the last, more are added."""
    if block.count("\n") == 1:
        return "".join(text.splitlines(keepends=True)[:-1]) + block
    return f"{text}\n{block}"


def _typed_in_turn(folder, block, codes):
    """Type the commands of a block; returns what the screen shows, and adds their exit codes to ``codes``."""
    screen = []
    for line in block.splitlines():
        command = line.removeprefix("$ ")
        if command.startswith("cbsr-qa "):
            done = typed(folder, command, check=False)
            codes.append(done.returncode)
            screen += [done.stderr, done.stdout]
        elif command == "echo $?":
            screen.append(str(codes[-1]))
        else:  # the shell's, of which the test has no need
            assert command.split()[0] in ("export", "mkdir", "cd"), command
    return " ".join(" ".join(screen).split())


def _words(report):
    """Return the text of a report in one line."""
    plain = re.sub(r"<(style|svg)\b.*?</\1>|<[^>]*>", " ", report.read_text(), flags=re.DOTALL)
    return " ".join(html.unescape(plain).split())
