"""The documentation as a site: built once, strictly, and then read."""

import inspect
import json
import os
import re
import subprocess
import sys
from functools import cache
from urllib.parse import unquote

import pytest
from pages import TOP

import cbsr_qa
from cbsr_qa.cli.command import commands, documents
from cbsr_qa.plugin import hooks

pytestmark = pytest.mark.rest

_PRESENTED = re.compile(r"<article.*?</article>", re.S)
_CODE = re.compile(r"<(pre|code|svg)\b.*?</\1>", re.S)


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


def test_no_markdown_is_left(site):
    left = r"\|[ -]*---|^\s*- \w.*|^\d+\. .*|```|\]\([^)]*\)|\*\*|^#+ .*"
    for page in _pages(site):
        (article,) = _PRESENTED.findall(_read(page)) or [""]
        text = re.sub(r"<h\d.*?</h\d>", "", _CODE.sub("", article))
        found = re.findall(left, re.sub(r"<[^>]+>", "", text), re.M)
        assert not found, (page, found)


def test_the_search_knows_every_page(site):
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    found = {(site / entry["location"].partition("#")[0]).resolve() for entry in index["docs"]}
    assert set(_pages(site)) <= found
    assert (site / "search" / "search_index.js").exists(), "pages opened from disk search this one"


def test_what_is_written_from_the_code_is_complete(site):
    reference = site / "reference"
    assert {command.words for command in commands()} == set(
        re.findall(r'<h2 id="[^"]*"><code>cbsr-qa ([^<]*)<', _read(reference / "commands.html"))
    )
    assert {words.replace(" ", "-") for words in documents()} < _places(reference / "schemas.html")
    assert {name for name in vars(hooks) if name.startswith("cbsr_")} < _places(reference / "hooks.html")
    assert {"sequencecontext", "measurement", "check_metric"} < _places(reference / "plugin-interface.html")


def test_the_page_on_python_has_signatures_members_flags_and_results_of_every_name(site):
    page = _read(site / "reference" / "python.html")
    names = [name for name in dir(cbsr_qa) if not name.startswith("_") and name != "door"]
    assert {name.lower() for name in names} < {place.lower() for place in _places(site / "reference" / "python.html")}
    words = re.sub(r"<[^>]+>", "", page)
    functions = [name for name in names if inspect.isfunction(getattr(cbsr_qa, name))]
    assert len(functions) > 6
    for name in functions:
        for parameter in inspect.signature(getattr(cbsr_qa, name)).parameters:
            assert re.search(rf"\b{parameter}\b", words[words.index(f"{name}(") :]), (name, parameter)
    assert all(flag.name in words for flag in cbsr_qa.Flag)
    assert {"forces", "severalforces", "trackedload", "places", "quantities"} < _places(
        site / "reference" / "python.html"
    )
    assert "place_stderr_mm" in words
    assert "Forces.interval_N(" in words
    assert 'href="schemas.html#run"' in page
