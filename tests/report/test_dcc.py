"""The digital calibration certificate: valid against the schemas of PTB, and read by others with the same values."""

import sys
from dataclasses import replace
from math import inf
from types import ModuleType
from xml.etree import ElementTree

import pytest
from certificates import HOSTILE, certificate, checked_load, expanded_force, largest_certificate, settings

from cbsr_qa.domain.results.certificate import Customer, Replacement
from cbsr_qa.report.dcc import DCC, SI, render_dcc

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
    "hostile": lambda: certificate(
        customer=Customer(HOSTILE, HOSTILE), replaced=Replacement("SSW-1", HOSTILE, 64 * "e"), reduced=(HOSTILE,)
    ),
    "one degree of freedom": lambda: certificate(
        forces=(expanded_force(dof=1.0, k=12.71), expanded_force(dof=inf, k=1.96, u_N=1e-7)),
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
    document = render_dcc(made()).decode()
    assert [str(error) for error in schema.iter_errors(document)] == []


@pytest.mark.shared
def test_the_schemas_refuse_another_document(schema):
    """The check above can fail."""
    document = render_dcc(certificate()).decode().replace("<dcc:issueDate>2026-11-22", "<dcc:issueDate>22.11.2026")
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
    read = reader(byte_array=render_dcc(made))
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
    error = results[f"{prefix} error of the indicated force"]
    assert _numbers(error["valueXMLList"]) == [load.error_N for load in made.checked]
    assert _numbers(error["expandedUncXMLList"]["uncertaintyXMLList"]) == [load.expanded.U_N for load in made.checked]


def _statements(made):
    root = ElementTree.fromstring(render_dcc(made))
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
    nothing = dict(_statements(MADE["nothing stated"]()))
    assert _declaration(nothing["simulation"]) == "Simulated: the sheet."
    assert _declaration(nothing["validity"]) == "not stated"
    assert nothing["conformity"].find("dcc:conformity", NAMES) is None


def test_a_replacement_is_named():
    root = ElementTree.fromstring(render_dcc(certificate(replaced=Replacement("SSW-1", "name corrected", 64 * "e"))))
    change = root.find("dcc:administrativeData/dcc:coreData/dcc:reportAmendedSubstituted", NAMES)
    assert change.findtext("dcc:replacedUniqueIdentifier", "", NAMES) == "SSW-1"
    previous = root.find("dcc:administrativeData/dcc:coreData/dcc:previousReport", NAMES)
    assert previous.findtext("dcc:value", "", NAMES) == 64 * "e"


def test_names_with_xml_in_them_are_text():
    root = ElementTree.fromstring(render_dcc(MADE["hostile"]()))
    customer = root.find("dcc:administrativeData/dcc:customer", NAMES)
    assert customer.findtext("dcc:name/dcc:content", "", NAMES) == HOSTILE
    assert customer.findtext("dcc:location/dcc:further/dcc:content", "", NAMES) == HOSTILE


def test_degrees_of_freedom_are_stated_in_the_order_of_the_values():
    document = render_dcc(MADE["one degree of freedom"]()).decode()
    assert "Effective degrees of freedom, in the order of the values: 1 infinite" in document


def test_the_document_claims_no_xml_signature():
    document = render_dcc(certificate()).decode()
    assert "Signature" not in document
    assert "xmldsig" not in document
