"""The digital calibration certificate: valid against the schemas of PTB, and read by others with the same values."""

import re
import sys
from dataclasses import replace
from html import unescape
from math import inf
from types import ModuleType
from xml.etree import ElementTree

import pytest
from certificates import HOSTILE, certificate, checked_load, expanded_force, largest_certificate, settings

from cbsr_qa.domain.results.certificate import Customer, Replacement
from cbsr_qa.report.certificate import render_certificate
from cbsr_qa.report.dcc import render_dcc
from cbsr_qa.report.dcc_elements import DCC, SI

NAMES = {"dcc": DCC, "si": SI}
MADE = {
    "usual": certificate,
    "largest": largest_certificate,
    "nothing stated": lambda: certificate(
        customer=Customer(),
        temperature_C=None,
        standards=(),
        valid_until=None,
        checked=(),
        settings=settings(max_error_N=0.0, max_error_percent=0.0, decision="", validity_months=None),
        identity=replace(certificate().identity, operator="", parts=(), simulated=("the sheet",)),
    ),
    "replaced after it was revoked": lambda: certificate(
        replaced=Replacement("SSW-1", "other head", 64 * "e", "revoked on 2026-11-21 by Ada: wrong head")
    ),
    "hostile": lambda: certificate(
        customer=Customer(HOSTILE, HOSTILE),
        replaced=Replacement("SSW-1", HOSTILE, 64 * "e"),
        reduced=(HOSTILE,),
        deviations=(HOSTILE,),
    ),
    "one degree of freedom": lambda: certificate(
        forces=(expanded_force(dof=1.0, k=12.71), expanded_force(dof=inf, k=1.96, u_N=1e-7)),
        forces_in_use=(expanded_force(dof=1.0, k=12.71), expanded_force(dof=inf, k=1.96, u_N=1e-7)),
        checked=(checked_load(0.9, dof=inf),),
    ),
}


@pytest.fixture(scope="module")
def schema(shared):
    """The schema of PTB, with those that it imports."""
    xmlschema = pytest.importorskip("xmlschema")
    folder = shared / "data" / "dcc"
    if not folder.is_dir():
        pytest.skip(f"the schemas of PTB are not in {folder}")
    locations = {
        "https://ptb.de/si": str(folder / "dsi-2.1.0.xsd"),
        "http://www.w3.org/2000/09/xmldsig#": str(folder / "xmldsig-core-schema.xsd"),
    }
    return xmlschema.XMLSchema(str(folder / "dcc-3.2.1.xsd"), locations=locations, allow="local")


@pytest.mark.shared
@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
def test_a_certificate_is_valid_against_the_schemas(schema, made):
    document = render_dcc(made(), "").decode()
    assert [str(error) for error in schema.iter_errors(document)] == []


@pytest.mark.shared
def test_the_schemas_refuse_another_document(schema):
    """The check above can fail."""
    document = (
        render_dcc(certificate(), "").decode().replace("<dcc:issueDate>2026-11-22", "<dcc:issueDate>22.11.2026")
    )
    assert len(list(schema.iter_errors(document))) == 1


@pytest.fixture
def reader(monkeypatch):
    """``DCC`` of pydcc. What it needs only to check XML signatures, or to fetch schemas, is left out.

    Its ``certvalidator`` loads oscrypto 1.3, which does not know the version of OpenSSL from 3.0.10 on.
    """
    stand_in = ModuleType("certvalidator")
    vars(stand_in).update(dict.fromkeys(("CertificateValidator", "errors", "ValidationContext")))
    monkeypatch.setitem(sys.modules, "certvalidator", stand_in)
    module = pytest.importorskip("dcc.dcc")
    monkeypatch.setattr(module, "DCCXMLValidator", lambda: None)
    return module.DCC


def _numbers(text):
    return [float(number) for number in text.split()]


def test_pydcc_reads_the_values_of_the_certificate(reader):
    made = certificate()
    read = reader(byte_array=render_dcc(made, ""))
    assert read.uid() == made.number
    assert read.version() == "3.2.1"
    assert read.calibration_date().date() == made.performed[1]
    assert read.calibration_laboratory_name() == "Soft Sensor Works"
    assert read.mandatory_language() == "en"
    serial, *_ = read.item_id()["identifications"]["identification"]
    assert serial["value"] == "S-1"
    results = {
        name.strip(): quantity["realListXMLList"] for name, quantity in read.get_calibration_results("name", "en")
    }
    prefix = "Force indicated by the sensor Expanded uncertainty of an indicated force"
    force = results[f"{prefix} force"]
    assert force["unitXMLList"] == r"\newton"
    assert _numbers(force["valueXMLList"]) == [one.force_N for one in made.forces]
    expanded = force["expandedUncXMLList"]
    assert _numbers(expanded["uncertaintyXMLList"]) == [one.U_N for one in made.forces]
    assert _numbers(expanded["coverageFactorXMLList"]) == [one.k for one in made.forces]
    assert _numbers(expanded["coverageProbabilityXMLList"]) == [0.95]
    for axis, name in enumerate(("place x", "place y")):
        place = results[f"{prefix} {name}"]
        assert place["unitXMLList"] == r"\milli\metre"
        assert _numbers(place["valueXMLList"]) == [one.place_mm[axis] for one in made.forces]
    prefix = "Force indicated by the sensor Error at loads that the calibration was not learned from"
    for name, values in (
        ("reference force", [load.reference_N for load in made.checked]),
        ("indicated force", [load.indicated_N for load in made.checked]),
        ("maximum permissible error", [load.max_error_N for load in made.checked]),
    ):
        assert _numbers(results[f"{prefix} {name}"]["valueXMLList"]) == values
    error = results[f"{prefix} error of the indicated force"]
    assert _numbers(error["valueXMLList"]) == [load.error_N for load in made.checked]
    assert _numbers(error["expandedUncXMLList"]["uncertaintyXMLList"]) == [load.expanded.U_N for load in made.checked]


def _statements(made):
    root = ElementTree.fromstring(render_dcc(made, ""))
    found = root.findall("dcc:administrativeData/dcc:statements/dcc:statement", NAMES)
    return [(one.findtext("dcc:name/dcc:content", "", NAMES), one) for one in found]


def _declaration(statement):
    return statement.findtext("dcc:declaration/dcc:content", "", NAMES)


def test_statements_begin_with_what_was_simulated_and_hold_conformity_and_validity():
    named = dict(_statements(certificate()))
    assert _statements(certificate())[0][0] == "simulation"
    assert _declaration(named["simulation"]) == "Nothing was simulated."
    assert named["conformity"].findtext("dcc:conformity", "", NAMES) == "pass"
    assert named["conformity"].findtext("dcc:norm", "", NAMES) == "JCGM 106:2012"
    assert named["validity"].findtext("dcc:date", "", NAMES) == "2027-11-21"
    assert named["traceability"].findtext("dcc:traceable", "", NAMES) == "true"
    nothing = dict(_statements(MADE["nothing stated"]()))
    assert nothing["traceability"].findtext("dcc:traceable", "", NAMES) == "false"
    assert _declaration(nothing["simulation"]) == "Simulated: the sheet."
    assert _declaration(nothing["validity"]) == "not stated"
    assert nothing["conformity"].find("dcc:conformity", NAMES) is None


def _flat(text):
    return " ".join(text.split())


def _clauses_of_page(page):
    """Return every clause of the page but its headings, the names of its rows, and its tables of numbers."""
    inside = re.sub(
        r"<(header|footer|h1|h2|title|style)\b.*?</\1>|<table class=\"grid.*?</table>|</?strong>",
        "",
        page,
        flags=re.S,
    )
    texts = re.findall(r"<(?:td|p|li|div)\b[^>]*>([^<]*)</", inside)
    return [
        clause
        for text in texts
        for clause in re.split(r"[.,;:]\s+|serial number | °C(?: to )?|[.]$", _flat(unescape(text)))
        if clause
    ]


#: Clauses that are about the paper, or lead to a list of inputs, which may be empty.
_PAPER = {
    "Simulated",
    "no physical sensor was calibrated",
    "See the remarks",
    "Date of issue",
    "Signature",
    "The 8 nearest to their limit are listed",
    "U without",
    "in use also without",
    "nothing",
}


@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
def test_whatever_the_page_states_stands_in_the_xml(made):
    one = made()
    clauses = _clauses_of_page(render_certificate(one, "9df4-03dd"))
    root = ElementTree.fromstring(render_dcc(one, "9df4-03dd"))
    document = _flat(" ".join(root.itertext()))
    assert len(clauses) > 60
    assert [clause for clause in clauses if clause not in document and clause not in _PAPER] == []


def test_what_the_results_are_about_is_stated_in_words_and_numbers():
    root = ElementTree.fromstring(render_dcc(certificate(), ""))
    result = root.find("dcc:measurementResults/dcc:measurementResult", NAMES)
    assert _flat(result.findtext("dcc:description/dcc:content", "", NAMES)) == (
        "For one frame of one load of the head (13 mm diameter) at a known place, 55.0 s after the press, from 1.4 N"
        " to 4.1 N within 39.9 mm of the sheet's centre."
    )
    found = {
        one.findtext("dcc:name/dcc:content", "", NAMES): (
            _numbers(one.findtext("si:realListXMLList/si:valueXMLList", "", NAMES)),
            one.findtext("si:realListXMLList/si:unitXMLList", "", NAMES),
        )
        for one in result.findall("dcc:measurementMetaData/dcc:metaData/dcc:data/dcc:quantity", NAMES)
    }
    assert found == {
        "time after the press": ([55.0], r"\second"),
        "least and largest force": ([1.4, 4.1], r"\newton"),
        "distance from the centre of the sheet": ([39.9], r"\milli\metre"),
    }


@pytest.mark.parametrize(("simulated", "word"), [((), "false"), (("the sheet",), "true")])
def test_a_machine_reads_whether_it_was_simulated(simulated, word):
    made = certificate(identity=replace(certificate().identity, simulated=simulated))
    (statement,) = [one for name, one in _statements(made) if name == "simulation"]
    assert statement.findtext("dcc:data/dcc:quantity/dcc:charsXMLList", "", NAMES) == word


def test_nobody_is_named_as_the_issuer_of_a_number_unless_that_is_known():
    root = ElementTree.fromstring(render_dcc(certificate(), ""))
    issuers = {
        one.findtext("dcc:name/dcc:content", "", NAMES): one.findtext("dcc:issuer", "", NAMES)
        for one in root.iterfind(".//dcc:identification", NAMES)
    }
    own = {"run", "calibration", "SHA-256 of the calibration"}
    assert {name for name, issuer in issuers.items() if issuer == "calibrationLaboratory"} == own
    assert {issuer for name, issuer in issuers.items() if name not in own} == {"other"}


def test_a_replacement_is_named():
    root = ElementTree.fromstring(
        render_dcc(certificate(replaced=Replacement("SSW-1", "name corrected", 64 * "e")), "")
    )
    change = root.find("dcc:administrativeData/dcc:coreData/dcc:reportAmendedSubstituted", NAMES)
    assert change.findtext("dcc:replacedUniqueIdentifier", "", NAMES) == "SSW-1"
    previous = root.find("dcc:administrativeData/dcc:coreData/dcc:previousReport", NAMES)
    assert previous.findtext("dcc:value", "", NAMES) == 64 * "e"


def test_names_with_xml_in_them_are_text():
    root = ElementTree.fromstring(render_dcc(MADE["hostile"](), ""))
    customer = root.find("dcc:administrativeData/dcc:customer", NAMES)
    assert customer.findtext("dcc:name/dcc:content", "", NAMES) == HOSTILE
    assert customer.findtext("dcc:location/dcc:further/dcc:content", "", NAMES) == HOSTILE


def test_degrees_of_freedom_are_stated_in_the_order_of_the_values():
    document = render_dcc(MADE["one degree of freedom"](), "").decode()
    assert "Effective degrees of freedom, in the order of the values: 1 infinite" in document


def test_the_document_claims_no_xml_signature():
    document = render_dcc(certificate(), "").decode()
    assert "Signature" not in document
    assert "xmldsig" not in document
