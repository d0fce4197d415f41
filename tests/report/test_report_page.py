"""The whole page: safe, whole, repeatable, and saying the important thing first."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import repeat
from pathlib import Path
from types import SimpleNamespace

import pytest
from copied import come_back, fork
from recording_samples import sample_recording
from report_samples import ended_early, sample_run

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement, decide
from cbsr_qa.domain.results.report import Cell, Figure, Paragraph, Section, Table
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.heads import recording_page, run_page
from cbsr_qa.report.render import render_recording, render_run, render_sections, report_name, write_report
from cbsr_qa_plugins.sections.limits import Limits
from cbsr_qa_plugins.sections.locations import NineLocations
from cbsr_qa_plugins.sections.traceability import Traceability

HOSTILE = "<script>alert(1)</script>\"' onload=x \u202eمرحبا שלום"
_VOID = {"meta", "br", "img", "hr", "link", "input"}


class Says:
    """A section with given content."""

    def __init__(self, *blocks, title="Said"):
        self._section = Section(title, blocks)

    def render(self, result):
        return self._section


class Fails:
    """A section that raises."""

    def __init__(self, error):
        self._error = error

    def render(self, result):
        raise self._error


class Forks:
    """A section that forks and goes on in both processes."""

    def render(self, result):
        fork()


@pytest.mark.parametrize(
    ("blocks", "why"),
    [
        (repeat(Paragraph("again")), "it has more than 1000 blocks"),
        ([Table("endless", ("a",), repeat(("x",)))], "the rows of table 'endless' are"),
    ],
)
def test_a_section_that_never_ends_is_left_out(result, blocks, why):
    endless = SimpleNamespace(render=lambda _: Section("Endless", blocks))
    page = Structure(render_run(result, [endless]))
    assert "is left out" in page.words()
    assert why in page.words()


def test_a_copy_that_a_section_forks_does_not_come_back(result):
    assert come_back(lambda: render_run(result, [Forks()])) == 1


class Structure(HTMLParser):
    """Collects elements and text, and refuses tags that do not pair."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.open, self.elements, self.text = [], [], []
        self.feed(html)
        self.close()
        assert not self.open, f"left open: {self.open}"

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text.append(data)

    def words(self):
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="module")
def result():
    return sample_run(size_mm=6.0)


def hostile_run(result):
    identity = replace(
        result.record.identity,
        sensor=replace(result.record.identity.sensor, serial=HOSTILE, batch=HOSTILE),
        operator=HOSTILE,
        simulated=(HOSTILE,),
        instruments=(replace(result.record.identity.instruments[0], model=HOSTILE, serial=HOSTILE),),
    )
    measured = Measurement(HOSTILE, 1.0, HOSTILE, how=HOSTILE, location=HOSTILE).judge(
        Limit(HOSTILE, HOSTILE, 0.0, 2.0)
    )
    refused = Measurement("plain", None, "1", how=HOSTILE)
    return replace(
        result,
        record=replace(result.record, identity=identity),
        measurements=(measured, refused),
        verdict=replace(decide((measured,)), reason=HOSTILE),
        warnings=(HOSTILE,),
        calibration=None,
        calibration_why=HOSTILE,
    )


def test_hostile_text_stays_text_everywhere(result):
    html = render_run(hostile_run(result), [Limits(), Traceability(), Says(Paragraph(HOSTILE), title=HOSTILE)])
    page = Structure(html)
    assert {tag for tag, _ in page.elements} & {"script", "iframe", "object", "embed", "link"} == set()
    assert not [a for _, attributes in page.elements for a in attributes if a.startswith("on")]
    assert html.count("<script") == 0
    assert page.words().count("<script>alert(1)</script>") >= 10
    assert "مرحبا" in page.words()


def test_text_from_outside_cannot_turn_the_line_around(result):
    html = render_run(hostile_run(result), [Traceability()])
    for found in re.finditer("\u202e", html):
        before = html[: found.start()]
        isolated = before.rfind("<bdi>") > before.rfind("</bdi>")
        own_line = any(before.rfind(f"<{tag}") > before.rfind(f"</{tag}>") for tag in ("title", "li", "p"))
        assert isolated or own_line


def test_the_page_loads_nothing_and_runs_nothing(result):
    html = render_run(result, [NineLocations(), Limits()])
    page = Structure(html)
    for tag, attributes in page.elements:
        for name in ("src", "href", "xlink:href", "action", "data", "srcset"):
            target = attributes.get(name, "#")
            assert target.startswith(("#", "data:image/png;base64,")), (tag, name, target[:60])
    css = "".join(re.findall(r"<style>(.*?)</style>", html, re.DOTALL))
    assert "url(" not in css
    assert "@import" not in css
    addresses = set(re.findall(r"https?://[^\s\"'<]+", html))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


def test_a_folded_table_unfolds_without_a_script_and_says_how_long_it_is(result):
    rows = tuple((Cell(f"{HOSTILE} {k}"),) for k in range(3))
    html = render_run(
        result, [Says(Table(f"all {HOSTILE}", ("x",), rows, folded=True), Table("short", ("x",), rows))]
    )
    page = Structure(html)
    assert [tag for tag, _ in page.elements if tag in ("details", "summary", "table", "caption")] == [
        "details",  # the annex
        "summary",
        "details",
        "summary",
        "table",
        "table",
        "caption",
    ]
    assert "(3 rows)" in page.words()
    assert "script" not in [tag for tag, _ in page.elements]


def test_every_entry_of_the_contents_leads_somewhere(result):
    sections = [section.render(result) for section in (NineLocations(), Limits(), Traceability())]
    page = Structure(render_sections(run_page(result), sections))
    anchors = {a["id"] for _, a in page.elements if "id" in a}
    links = [a["href"][1:] for tag, a in page.elements if tag == "a"]
    assert len(links) == 3
    assert set(links) <= anchors
    assert len([a["id"] for _, a in page.elements if "id" in a]) == len(anchors)


def test_the_same_result_gives_the_same_bytes(result):
    sections = [NineLocations(), Limits(), Traceability()]
    assert render_run(result, sections) == render_run(result, sections)


@pytest.mark.parametrize(
    ("value", "headline", "reason"),
    [
        (1.0, "PASS", "the only limit is met"),
        (4.8, "MARGINAL PASS", "error is 4.8 mm"),
        (7.0, "FAIL", "error is 7 mm"),
        (None, "NOT MEASURED", "could not be measured: no blob"),
    ],
)
def test_the_banner_says_verdict_and_reason_first(result, value, headline, reason):
    limit = Limit("error", "mm", None, 5.0, marginal=0.5)
    measured = (Measurement("error", value, "mm", how="no blob").judge(limit),)
    judged = replace(result, measurements=measured, verdict=decide(measured))
    words = Structure(render_run(judged, [])).words()
    body = words[words.index("Test report ·") :]
    assert headline in body[:80]
    assert reason in body
    assert body.index(reason) < body.index("Sensor")


@pytest.mark.parametrize(
    ("end", "said"),
    [
        (EndReason.ABORTED, "The run was aborted: SIGINT"),
        (EndReason.BROKEN, "The run broke off: SIGINT"),
        (EndReason.RUNNING, "The run is incomplete"),
    ],
)
def test_a_run_that_did_not_finish_says_how_it_ended_and_never_passes(result, end, said):
    early = ended_early(result)
    stopped = replace(
        early, record=replace(early.record, end=end), verdict=replace(early.verdict, outcome=Outcome.NOT_MEASURED)
    )
    banner = run_page(stopped).banner
    assert banner.reason.startswith(said)
    assert banner.headline == "NOT MEASURED"
    Structure(render_run(stopped, [NineLocations(), Limits(), Traceability()]))


def test_a_simulated_run_says_so_and_a_real_one_does_not(result):
    assert "Simulated." in Structure(render_run(result, [])).words()
    real = replace(
        result, record=replace(result.record, identity=replace(result.record.identity, simulated=(), station="bench"))
    )
    assert "imulated" not in Structure(render_run(real, [])).words()


def test_a_section_that_fails_is_named_and_takes_nothing_else_down(result):
    sections = [
        Fails(ZeroDivisionError("by <zero>")),
        Fails(NumericsError("rank 3 of 208", remedy="mask less")),
        Says(Paragraph("still here"), title="After"),
    ]
    words = Structure(render_run(result, sections, warnings=["a plugin is missing"])).words()
    assert "section Fails failed and is left out: ZeroDivisionError: by <zero>" in words
    assert "rank 3 of 208" in words
    assert "a plugin is missing" in words
    assert "still here" in words


@pytest.mark.parametrize(
    "block",
    [
        Figure("c", "a", '<svg xmlns="http://www.w3.org/2000/svg"><script/></svg>'),
        Figure("c", "a", "no svg at all"),
        Table("t", ("a", "b"), ((Cell("one cell"),),)),
        "not a block",
    ],
)
def test_content_that_cannot_be_shown_safely_leaves_its_section_out(result, block):
    page = Structure(render_run(result, [Says(Paragraph("gone"), block), Says(Paragraph("kept"))]))
    assert "section Says failed and is left out" in page.words()
    assert "gone" not in page.words()
    assert "kept" in page.words()


def test_cells_of_a_wide_table_break_so_that_its_last_column_is_on_the_page(result):
    driver, columns = "marlin-applicator", tuple("abcdefgh")
    wide = Table("wide", columns, ((Cell(driver),) * 8,))
    narrow = Table("narrow", columns[:7], ((Cell(driver),) * 7,))
    page = render_run(result, [Says(wide, narrow)])
    assert page.count(f'<td class="words"><bdi>{driver}') == 8
    assert page.count(f'<td class="words tight"><bdi>{driver}') == 7


def test_blocks_come_out_as_what_they_are(result):
    table = Table("Caption & more", ("Name", "N"), ((Cell("a"), Cell("1", Outcome.FAIL)),), (1,))
    empty = Table("Nothing", ("Name",), ())
    blocks = (Paragraph("plain"), Paragraph("careful", "warning"), table, empty)
    page = Structure(render_run(result, [Says(*blocks)]))
    classes = [a.get("class", "") for _, a in page.elements]
    assert any("outcome fail" in c and "number" in c for c in classes)
    assert "warning" in classes
    assert "Caption & more" in page.words()
    assert "nothing to list" in page.words()


def test_a_recording_says_what_was_found_in_it():
    page = recording_page(sample_recording(2))
    assert page.banner.headline == "2 events found"
    assert "the place conducts less" in page.banner.reason
    none = recording_page(sample_recording(0))
    assert none.banner.headline == "no event"
    assert none.banner.reason == "nothing stands out of the noise"
    words = Structure(render_recording(sample_recording(1), [NineLocations(), Says(Paragraph("rows"))])).words()
    assert "1 event found" in words
    assert "exp<1>.csv" in words
    assert "failed" not in words


def test_what_is_only_worth_knowing_about_a_recording_is_no_warning():
    recording = replace(sample_recording(1), warnings=("1 row was rejected, see the list of <problems>",))
    words = Structure(render_recording(recording, [])).words()
    assert "1 remark 1 row was rejected, see the list of <problems>" in words
    assert "warning" not in words
    missing = Structure(render_recording(recording, [], warnings=["a plugin is missing"])).words()
    assert "1 warning a plugin is missing 1 remark" in missing


def test_a_report_is_written_whole(tmp_path):
    path = tmp_path / "new" / "report.html"
    write_report(path, "first")
    write_report(path, "second \u202e \udcff")
    assert path.read_bytes().startswith(b"second \xe2\x80\xae ")
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]


@pytest.mark.parametrize("kept", [b"SQLite format 3\0", b"[study]\n", b"<html>"])
def test_a_page_takes_the_place_of_a_page_and_of_nothing_else(tmp_path, kept):
    (tmp_path / "kept").write_bytes(kept)
    (tmp_path / "empty").touch()
    page = "<!DOCTYPE html>\n<title>new</title>"
    with pytest.raises(RefusedError, match=r"refusing to overwrite .*kept: not an HTML page"):
        write_report(tmp_path / "kept", page)
    assert (tmp_path / "kept").read_bytes() == kept
    for name in ("empty", "new", "new"):
        write_report(tmp_path / name, page)
        assert (tmp_path / name).read_text() == page
    with pytest.raises(RefusedError, match="refusing to overwrite /dev/null"):
        write_report(Path("/dev/null"), page)


def test_a_folder_that_cannot_be_written_to_is_refused_by_name(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RefusedError, match=r"file.reports"):
        write_report(tmp_path / "file" / "reports" / "r.html", "x")
    assert (tmp_path / "file").read_text() == "in the way"


def test_nothing_is_left_behind_where_the_last_step_fails(tmp_path):
    (tmp_path / "r.html").mkdir()
    with pytest.raises(RefusedError, match="cannot be written"):
        write_report(tmp_path / "r.html", "x")
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


@pytest.mark.parametrize("serial", ["../../x", "<script>", "a" * 5000, "C:\\x", "..", ".hidden", "né/☃", "a b"])
def test_a_name_from_outside_never_leaves_the_folder(serial):
    name = report_name(serial, "0199-run")
    assert re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]*", name)
    assert name.endswith("0199-run.html")
    assert len(name) < 200
