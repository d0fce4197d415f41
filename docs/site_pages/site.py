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
from python_page import python_page

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

#: Modules → pages that are written from them, to which links to these modules lead.
FROM_CODE = {
    "cbsr_qa/plugin/hooks.py": "reference/hooks.md",
    "cbsr_qa/plugin/instruments.py": "reference/plugin-interface.md",
    "cbsr_qa/plugin/interfaces.py": "reference/plugin-interface.md",
    "cbsr_qa/cli": "reference/commands.md",
}

#: Titles of sections of the navigation → their folders; each gets an index page.
SECTIONS = {"Tutorials": "tutorials", "How-to": "how-to", "Explanation": "explanation", "Reference": "reference"}

_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
_FENCED = re.compile(r"(^```.*?^```)", re.M | re.S)

_made: dict[str, str] = {}


def on_config(config: MkDocsConfig) -> None:
    """Make the pages, and complete the navigation."""
    _made.clear()
    _made.update({site: (TOP / name).read_text(encoding="utf-8") for name, site in BESIDE.items()})
    _made["reference/commands.md"] = command_page(DOCS)
    _made["reference/schemas.md"] = interface_pages.schemas()
    _made["reference/hooks.md"] = interface_pages.hooks()
    _made["reference/plugin-interface.md"] = interface_pages.interface()
    for entry in config.nav or []:
        ((title, below),) = entry.items()
        for inner in below if title == "Project" else ():
            if isinstance(inner, dict):
                inner["Decisions"] = ["decisions/README.md", *_names("decisions", "[0-9]*.md")]
        if title in SECTIONS:
            index = f"{SECTIONS[title]}/index.md"
            _made[index] = _index(title, below, SECTIONS[title])
            entry[title] = [index, *below]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that were made."""
    for name, text in _made.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Lead links out of docs/ to their place on the site; of links to code without a page, only the text is left."""
    name = page.file.src_uri
    if name == "reference/python.md":
        markdown = python_page(markdown)
    beside = {site: beside for beside, site in BESIDE.items()}.get(name)
    if name in _made and not beside:
        return markdown
    folder = TOP if beside else (DOCS / name).parent

    def link(found: re.Match[str]) -> str:
        image, text, target = found.groups()
        path, mark, anchor = target.partition("#")
        place = (folder / path).resolve()
        if not path or "://" in path or not place.exists():
            return found[0]
        below = os.path.relpath(place, TOP)
        site = BESIDE.get(below) or FROM_CODE.get(below) or os.path.relpath(place, DOCS)
        if site.startswith(".."):
            return text
        return f"{image}[{text}]({os.path.relpath(site, Path(name).parent)}{mark}{anchor})"

    parts = _FENCED.split(markdown)
    return "".join(part if part.startswith("```") else _LINK.sub(link, part) for part in parts)


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
    paragraph = re.sub(rf" \({_LINK.pattern}\)", "", paragraph)  # an aside that is only a link
    plain = _LINK.sub(lambda found: found[2], paragraph)
    return title, re.split(r"(?<=[^.]{2}[.])(?<!et al\.) (?=[A-Z*`])", plain, maxsplit=1)[0].rstrip(":")
