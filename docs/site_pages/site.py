"""Hooks of MkDocs: pages that are made when the site is built, and links that lead out of docs/."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import interface_pages
from command_page import command_page
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

DOCS = Path(__file__).resolve().parents[1]
TOP = DOCS.parent

#: Pages beside docs/ → their names on the site.
BESIDE = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "ARCHITECTURE.md": "architecture.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}

#: Titles of sections of the navigation → their folders; each gets an index page.
SECTIONS = {"Tutorials": "tutorials", "How-to": "how-to", "Explanation": "explanation", "Reference": "reference"}

_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
_FENCED = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.M | re.S)

_made: dict[str, str] = {}


def on_config(config: MkDocsConfig) -> None:
    """Make the pages, and complete the navigation."""
    _made.clear()
    _made.update({site: (TOP / name).read_text(encoding="utf-8") for name, site in BESIDE.items()})
    _made["reference/commands.md"] = command_page(DOCS)
    _made["reference/schemas.md"] = interface_pages.schemas()
    _made["reference/hooks.md"] = interface_pages.hooks()
    _made["reference/python.md"] = interface_pages.interface()
    for entry in config.nav or []:
        ((title, below),) = entry.items()
        if below == "decisions":
            entry[title] = ["decisions/README.md", *_names("decisions", "[0-9]*.md")]
        elif title in SECTIONS:
            index = f"{SECTIONS[title]}/index.md"
            _made[index] = _index(title, below, SECTIONS[title])
            entry[title] = [index, *below]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that were made."""
    for name, text in _made.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Lead links to pages beside docs/ to their place on the site; links to code become its path."""
    name = page.file.src_uri
    home = {site: beside for beside, site in BESIDE.items()}.get(name)
    folder = TOP if home else (DOCS / name).parent

    def link(found: re.Match[str]) -> str:
        image, text, target = found.groups()
        path, mark, anchor = target.partition("#")
        if not path or "://" in path or name in _made and not home:
            return found[0]
        place = (folder / path).resolve()
        beside = str(place.relative_to(TOP)) if place.is_relative_to(TOP) else ""
        if beside in BESIDE:
            site = BESIDE[beside]
        elif place.is_relative_to(DOCS):
            site = str(place.relative_to(DOCS))
        elif place.exists():
            return text
        else:
            return found[0]
        return f"{image}[{text}]({os.path.relpath(site, Path(name).parent)}{mark}{anchor})"

    parts = _FENCED.split(markdown)
    # Code keeps its text; a link around code is found over both.
    whole, kept = "", []
    for part in parts:
        if part.startswith("```"):
            kept.append(part)
            part = f"\x00{len(kept) - 1}\x00"
        whole += part
    return re.sub(r"\x00(\d+)\x00", lambda found: kept[int(found[1])], _LINK.sub(link, whole))


def _names(folder: str, pattern: str) -> list[str]:
    return sorted(str(path.relative_to(DOCS)) for path in (DOCS / folder).glob(pattern))


def _index(title: str, below: list[Any], folder: str) -> str:
    return "\n".join([f"# {title}", "", *_listed(below, folder)]) + "\n"


def _listed(below: list[Any], folder: str) -> Iterator[str]:
    for entry in below:
        if isinstance(entry, dict):
            for heading, pages in entry.items():
                yield from ["", f"## {heading}", "", *_listed(pages, folder)]
        else:
            heading, sentence = _beginning(entry)
            yield f"- [{heading}]({os.path.relpath(entry, folder)}): {sentence}"


def _beginning(name: str) -> tuple[str, str]:
    """Return title and first sentence of a page."""
    path = DOCS / name
    if name not in _made and not path.exists():
        raise FileNotFoundError(f"mkdocs.yml: {name} is in the navigation, but not in docs/")
    text = _made.get(name) or path.read_text(encoding="utf-8")
    title, _, rest = text.removeprefix("# ").partition("\n")
    paragraph = " ".join(re.split(r"\n\n|\n```|\n\|", rest.strip(), maxsplit=1)[0].split())
    plain = _LINK.sub(lambda found: found[2], paragraph)
    return title, re.split(r"(?<=[^.]{2}[.])(?<!et al\.) (?=[A-Z*`])", plain, maxsplit=1)[0].rstrip(":")
