"""The pages that a newcomer reads first: they are short, and what they lead to exists."""

import re
import subprocess

import pytest
from pages import TOP


def _files():
    """Tracked files and those to be added, and their folders, relative to the checkout."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=TOP,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode:
        pytest.skip("this is no checkout")
    files = {f"/{name}" for name in listed.stdout.splitlines()}
    return files | {f"/{name[1 : end + 1]}" for name in files for end in _slashes(name)}


def _slashes(name):
    return [place for place, letter in enumerate(name) if letter == "/" and place]


def test_every_path_of_the_architecture_leads_somewhere():
    page = (TOP / "ARCHITECTURE.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w.*-]+/[\w./*-]*|\w+\.(?:py|toml|md|j2))`", page)
    assert len(named) > 100
    files = _files()
    for path in named:
        ending = re.compile("/" + re.escape(path).replace(r"\*", "[^/]*") + "$")
        assert any(ending.search(file) for file in files), path


def test_the_architecture_is_one_page():
    assert len((TOP / "ARCHITECTURE.md").read_text(encoding="utf-8").split()) <= 1200


def test_the_changelog_says_on_one_page_what_the_first_version_has():
    first = (TOP / "CHANGELOG.md").read_text(encoding="utf-8").partition("## [0.1.0]")[2]
    assert 100 < len(first.split()) <= 600


def test_the_readme_leads_eight_roles_to_three_pages_each_at_most():
    table = (TOP / "README.md").read_text(encoding="utf-8").partition("| you are | read |")[2].partition("\n\n")[0]
    rows = [line for line in table.splitlines() if line.startswith("| ") and "---" not in line]
    assert len(rows) == 8
    assert all(1 <= row.count("](") <= 3 for row in rows)
