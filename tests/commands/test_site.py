"""The documentation as a site: built once, strictly, and then read."""

import os
import re
import subprocess
import sys
from functools import cache
from urllib.parse import unquote

import pytest
from pages import TOP

from cbsr_qa.cli import commands, documents
from cbsr_qa.plugin import hooks

pytestmark = pytest.mark.rest


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", folder],
        cwd=TOP,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert built.returncode == 0, built.stderr
    return folder


def _pages(site):
    return [page for page in sorted(site.rglob("*.html")) if page.name != "404.html"]


@cache
def _read(page):
    return page.read_text(encoding="utf-8")


@cache
def _places(page):
    return set(re.findall(r'\sid="([^"]+)"', _read(page)))


def test_links_and_anchors_of_the_site_lead_somewhere(site):
    broken = []
    for page in _pages(site):
        for target in set(re.findall(r'<(?:a|img|script|link)\b[^>]*\s(?:href|src)="?([^"\s>]+)', _read(page))):
            path, _, anchor = unquote(target).partition("#")
            if re.match(r"\w+:", path):
                continue
            found = (page.parent / path.partition("?")[0]).resolve() if path else page
            found = found / "index.html" if found.is_dir() else found
            if not found.exists() or (anchor and found.suffix == ".html" and anchor not in _places(found)):
                broken.append(f"{page.relative_to(site)}: {target}")
    assert not broken


def test_every_page_is_in_the_navigation(site):
    start = _read(site / "index.html")
    (navigation,) = re.findall(r'<div class="md-sidebar md-sidebar--primary".*?<div class="md-content"', start, re.S)
    listed = {(site / target).resolve() for target in re.findall(r'href="([^"#]+)"', navigation)}
    assert set(_pages(site)) <= listed
    assert len(listed) > 90


def test_nothing_is_fetched_from_elsewhere(site):
    for page in _pages(site):
        loaded = re.findall(r"<(?:script|link|img|iframe|source|object)\b[^>]*https?://[^>]*>", _read(page))
        assert not loaded, page
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(.?https?:|@import", style.read_text(encoding="utf-8")), style


def test_what_is_written_from_the_code_is_complete(site):
    reference = site / "reference"
    assert {command.words for command in commands()} == set(
        re.findall(r'<h2 id="[^"]*"><code>cbsr-qa ([^<]*)<', _read(reference / "commands.html"))
    )
    assert {words.replace(" ", "-") for words in documents()} < _places(reference / "schemas.html")
    assert {name for name in vars(hooks) if name.startswith("cbsr_")} < _places(reference / "hooks.html")
    assert {"sequencecontext", "measurement", "check_metric"} < _places(reference / "plugin-interface.html")
