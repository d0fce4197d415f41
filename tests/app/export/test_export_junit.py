"""Outcomes as JUnit XML, by the rules of the schema that Jenkins holds such files to."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import xmlschema
from exported_runs import five_runs

from cbsr_qa.app.export.export import ExportRequest, export_data

#: The schema of Jenkins' xUnit plugin, as pytest 9.2 ships it in its tests (MIT).
SCHEMA = xmlschema.XMLSchema(str(Path(__file__).with_name("junit-10.xsd")))


@pytest.fixture(scope="module")
def suites(tmp_path_factory):
    folder = tmp_path_factory.mktemp("junit")
    url, names = five_runs()
    result = export_data(ExportRequest(folder / "out.xml"), database=url, tell=print).result
    assert (result.format, result.runs, result.table, result.rows) == ("junit", 5, None, None)
    root = ElementTree.fromstring((folder / "out.xml").read_bytes())
    SCHEMA.validate(root)
    return {name: root[number] for number, name in enumerate(names)}


def results(suite):
    """What each case is, by the first word of its name."""
    cases = suite.findall("testcase")
    assert len({case.get("name") for case in cases}) == len(cases) == int(suite.get("tests"))
    kinds = {case.get("name").split()[0]: [child.tag for child in case] for case in cases}
    for kind, count in (("failure", "failures"), ("error", "errors"), ("skipped", "skipped")):
        assert sum(kind in tags for tags in kinds.values()) == int(suite.get(count))
    return kinds


def test_a_suite_a_run_and_a_case_a_measurement_with_a_limit(suites):
    suite = suites["passed"]
    assert results(suite) == {"centre": ["system-out"], "drift": []}
    assert suite.find("testcase/system-out").text.startswith("marginal: centre of mass error (L0) is 5.5 mm")
    assert re.fullmatch(r"2026-11-21T08:00:00", suite.get("timestamp"))
    assert (suite.get("hostname"), suite.get("time")) == ("bench-α", "201.000")
    properties = {each.get("name"): each.get("value") for each in suite.iter("property")}
    assert (properties["serial"], properties["verdict"], properties["run"]) == ("S-0", "marginal", suite.get("id"))
    assert {case.get("classname") for case in suite.iter("testcase")} == {"short.S-0"}


def test_a_failure_names_value_unit_and_limit(suites):
    assert results(suites["failed"]) == {"centre": ["failure"], "drift": []}
    failure = suites["failed"].find("testcase/failure")
    assert failure.get("message") == "centre of mass error (L0) is 7.25 mm (allowed: at most 6.5 mm)"
    assert failure.get("type") == "fail"


def test_what_could_not_be_measured_is_an_error(suites):
    assert results(suites["unmeasured"]) == {"centre": [], "drift": ["error"]}
    assert suites["unmeasured"].find("testcase/error").get("message") == "drift could not be measured: no frame"


def test_a_run_that_did_not_finish_is_an_error_without_characters_that_xml_forbids(suites):
    assert results(suites["aborted"]) == {"run": ["error"]}
    error = suites["aborted"].find("testcase/error")
    assert (error.get("message"), error.get("type")) == ("the run was aborted: by\ufffd the operator", "aborted")


def test_an_overridden_failure_is_skipped_with_the_reason(suites):
    assert results(suites["overridden"]) == {"centre": ["skipped"], "drift": []}
    words = suites["overridden"].find("testcase/skipped").get("message")
    assert words.startswith("overridden by Ada: the head was bent; centre of mass error (L0) is 9 mm")
