"""From a result and its sections to one self-contained HTML file."""

import re
from collections.abc import Iterator, Sequence, Sized
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import with_type
from cbsr_qa.domain.results.findings import RecordingResult
from cbsr_qa.domain.results.report import Block, Figure, Page, Paragraph, Section, Table
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.plugin.failures import failure
from cbsr_qa.plugin.interfaces import ReportSection
from cbsr_qa.report.heads import recording_page, run_page
from cbsr_qa.report.section import limit_blocks
from cbsr_qa.report.svg import check_svg
from cbsr_qa.system.copies import end_forked_copies
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.foreign import open_foreign

_TEMPLATE: Final = "report.html.j2"
_STYLE: Final = "report.css"
_FRAGMENT: Final = "fragment.html.j2"
_FRAGMENT_STYLE: Final = "fragment.css"
#: Beginning of every page.
_PAGE: Final = "<!DOCTYPE html>"


@dataclass(frozen=True, slots=True)
class _Shown:
    """A section as the template sees it: blocks with their kind, figures checked."""

    anchor: str
    title: str
    blocks: tuple[tuple[str, Any], ...]
    leaf: int | None = None


def render_run(
    result: RunResult, sections: Sequence[ReportSection], *, warnings: Sequence[str] = (), opened: bool = False
) -> str:
    """Render a run's report, its leading pages and its annexes: the same input gives the same bytes.

    Parameters
    ----------
    result : everything concluded from the run.
    sections : sections in the order they are printed. One that raises, or returns what cannot be shown safely, is
        replaced by a warning with its name and takes nothing else down.
    warnings : other things that went wrong before, e.g. a section plugin that could not be loaded.
    opened : whether annexes are open, so that they are printed; folded ones are not.

    Returns
    -------
    One HTML document without scripts, that loads nothing, with all text escaped.
    """
    failed: list[str] = []
    shown = tuple(_render_each(sections, result, failed))
    leading = sorted((section for section in shown if section.leaf), key=lambda section: section.leaf or 0)
    annexes = [section for section in shown if section.leaf is None]
    return _page(run_page(result), leading, (*warnings, *failed), annexes, opened=opened)


def render_recording(
    result: RecordingResult, sections: Sequence[ReportSection], *, warnings: Sequence[str] = ()
) -> str:
    """Render a recording's report; see :func:`render_run`."""
    failed: list[str] = []
    shown = tuple(_render_each(sections, result, failed))
    return _page(recording_page(result), shown, (*warnings, *failed))


def render_sections(page: Page, sections: Sequence[Section]) -> str:
    """Render a page whose sections are there already, in the look of the reports; see :func:`render_run`.

    Raises
    ------
    RefusedError
        If a section holds what cannot be shown safely.
    """
    return _page(page, [_prepare(section, f"s{n}") for n, section in enumerate(sections, start=1)], ())


def render_fragment(page: Page, sections: Sequence[Section]) -> str:
    """Render a page as one element for a page of others, such as a notebook; see :func:`render_sections`.

    Its style applies to it alone (CSS ``@scope``); where a browser does not know that, it has no style.
    """
    environment, style = (
        make_environment(),
        re.sub(r"(?m)^(\s*)(?::root|html|body)\b", r"\1:scope", read_style(_STYLE)),
    )
    style = re.sub(r"(?m)^@page .*\n", "", style)
    prepared = [_prepare(section, "") for section in sections]
    return environment.get_template(_FRAGMENT).render(
        page=page,
        sections=prepared,
        warnings=page.warnings,
        style=Markup(style + read_style(_FRAGMENT_STYLE)),
        anchors=False,
    )


def write_report(path: Path, html: str) -> None:
    """Write a report whole or not at all.

    Raises
    ------
    RefusedError
        If the path is a folder, holds something else than a page, or its folder cannot be made or
        written to; names it, and leaves nothing behind.
    """
    _check_no_folder(path)
    if html.startswith(_PAGE):
        check_replaceable(path)
    remedy = "make the folder writable, name another, or set CBSR_QA_VAR where no file was named"
    with writing(path, remedy=remedy):
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as file:
            file.write(html.encode("utf-8", errors="xmlcharrefreplace"))


def check_replaceable(path: Path) -> None:
    """Refuse to replace a folder, database, study or device by a page: it would be lost for good.

    Raises
    ------
    RefusedError
        If something else than a page is there, or it cannot be read.
    """
    _check_no_folder(path)
    if not path.exists():
        return
    with writing(path):
        if path.is_file():
            with open_foreign(path) as file:
                begins = file.read(len(_PAGE)).decode("latin-1")
            if begins.lower() in ("", _PAGE.lower()):
                return
    raise RefusedError(
        f"refusing to overwrite {path}: not an HTML page", remedy="name another file, for example page.html"
    )


def _check_no_folder(path: Path) -> None:
    if path.is_dir():
        raise RefusedError(f"{path} cannot be written: it is a folder", remedy="name a file in it")


def report_name(*parts: str) -> str:
    """Return a file name from a serial number, a run or a recording's name, whatever they contain.

    Everything but letters, digits, dot, dash and underscore becomes an underscore; leading dots go; each part
    keeps at most 80 characters.
    """
    safe = [re.sub(r"[^A-Za-z0-9._-]+", "_", part).lstrip(".")[:80] for part in parts]
    return "-".join(part for part in safe if part) + ".html"


def _page(
    page: Page,
    shown: Sequence[_Shown],
    warnings: Sequence[str],
    annexes: Sequence[_Shown] = (),
    *,
    opened: bool = False,
) -> str:
    return (
        make_environment()
        .get_template(_TEMPLATE)
        .render(
            page=page,
            sections=shown,
            annexes=annexes,
            opened=opened,
            warnings=(*page.warnings, *warnings),
            style=Markup(read_style(_STYLE)),
            anchors=True,
        )
    )


def read_style(name: str) -> str:
    """Return a style sheet of the pages."""
    return PackageLoader("cbsr_qa._reports", ".").get_source(make_environment(), name)[0]


def make_environment() -> Environment:
    """Return what renders the templates of the pages: all text is escaped, and nothing may be missing."""
    return Environment(
        loader=PackageLoader("cbsr_qa._reports", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _render_each(
    sections: Sequence[ReportSection], result: RunResult | RecordingResult, failed: list[str]
) -> Iterator[_Shown]:
    for number, section in enumerate(sections, start=1):
        rendered = _section_shown(section, result, f"s{number}")
        if isinstance(rendered, str):
            failed.append(rendered)
        elif rendered is not None:
            yield rendered


def _section_shown(section: ReportSection, result: RunResult | RecordingResult, anchor: str) -> _Shown | str | None:
    """Render one section; return a warning where it fails."""
    try:
        with end_forked_copies():
            content = section.render(result)
            if content is None:
                return None
            return _prepare(replace(content, blocks=limit_blocks(content.blocks)), anchor)
    except BaseException as error:  # noqa: BLE001 - a plugin's code may raise anything
        return f"The report section {type(section).__name__} failed and is left out: {failure(error)}"


def _prepare(section: Section, anchor: str) -> _Shown:
    return _Shown(anchor, section.title, tuple(_block(block) for block in section.blocks), section.leaf)


def _block(block: Block) -> tuple[str, Any]:
    if isinstance(block, Figure):
        svg = Markup(
            check_svg(block.svg() if callable(block.svg) else block.svg)
        )  # nothing passes that could do more than be looked at
        return "figure", {"svg": svg, "caption": block.caption, "alternative": block.alternative}
    if isinstance(block, Table):
        _check_table(block)
        return "table", block
    if isinstance(block, Paragraph):
        return "paragraph", block
    raise RefusedError(f"a section holds a {type(block).__name__}; it may hold paragraphs, tables and figures")


def _check_table(table: Table) -> None:
    if not isinstance(table.rows, Sized):
        raise RefusedError(f"the rows of table {table.caption!r} are {with_type(table.rows)}; they must be a tuple")
    for number, row in enumerate(table.rows, start=1):
        if len(row) != len(table.columns):
            raise RefusedError(
                f"row {number} of table {table.caption!r} has {len(row)} cells for {len(table.columns)} columns"
            )
