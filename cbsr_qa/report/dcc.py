"""A certificate as a digital calibration certificate (DCC 3.2.1 of PTB, values in D-SI 2.1.0), an XML document.

Texts enter the tree as text, so that nothing of them is read as XML. The document holds no XML signature.
"""

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from cbsr_qa.domain.results.certificate import NOT_STATED, Certificate
from cbsr_qa.domain.results.expanded_force import ExpandedForce
from cbsr_qa.report.certificate import (
    describe_checked,
    describe_rule,
    describe_traceability,
    describe_use,
    list_missing,
    list_remarks,
    state_conformity,
)

DCC: Final = "https://ptb.de/dcc"
SI: Final = "https://ptb.de/si"
_VERSION: Final = "3.2.1"
_PROBABILITY: Final = "0.95"
_LANGUAGE: Final = "en"


def render_dcc(certificate: Certificate) -> bytes:
    """Render a certificate as XML, UTF-8; numbers with all their digits."""
    ElementTree.register_namespace("dcc", DCC)
    ElementTree.register_namespace("si", SI)
    root = Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": _VERSION})
    _add_administration(_add(root, "administrativeData"), certificate)
    _add_results(_add(_add(root, "measurementResults"), "measurementResult"), certificate)
    ElementTree.indent(root)
    document: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return document + b"\n"


def _add(parent: Element, name: str, text: str | None = None, **attributes: str) -> Element:
    element = SubElement(parent, f"{{{DCC}}}{name}", attributes)
    element.text = text
    return element


def _add_text(parent: Element, name: str, text: str) -> Element:
    """Add an element of the type that holds text in several languages."""
    element = _add(parent, name)
    _add(element, "content", text, lang=_LANGUAGE)
    return element


def _add_administration(data: Element, certificate: Certificate) -> None:
    software = _add(_add(data, "dccSoftware"), "software")
    name, version = certificate.identity.software[0]
    _add_text(software, "name", name)
    _add(software, "release", version)
    _add_core(_add(data, "coreData"), certificate)
    _add_item(_add(data, "items"), certificate)
    settings = certificate.settings
    contact = _add(_add(data, "calibrationLaboratory"), "contact")
    _add_text(contact, "name", settings.laboratory)
    if settings.email:
        _add(contact, "eMail", settings.email)
    location = _add(contact, "location")
    for part, text in (("street", settings.street), ("postCode", settings.post_code), ("city", settings.city)):
        _add(location, part, text)
    _add(location, "countryCode", settings.country)
    person = _add(_add(data, "respPersons"), "respPerson")
    _add_text(_add(person, "person"), "name", settings.signatory)
    _add(person, "role", settings.function)
    _add(person, "mainSigner", "true")
    customer = _add(data, "customer")
    _add_text(customer, "name", certificate.customer.name or NOT_STATED)
    _add_text(_add(customer, "location"), "further", certificate.customer.address or NOT_STATED)
    _add_statements(_add(data, "statements"), certificate)


def _add_core(core: Element, certificate: Certificate) -> None:
    _add(core, "countryCodeISO3166_1", certificate.settings.country)
    _add(core, "usedLangCodeISO639_1", _LANGUAGE)
    _add(core, "mandatoryLangCodeISO639_1", _LANGUAGE)
    _add(core, "uniqueIdentifier", certificate.number)
    run, digest = certificate.identity.run, certificate.calibration_digest
    named = [("run", run), ("calibration", certificate.calibration), ("SHA-256 of the calibration", digest)]
    _add_identifications(core, "calibrationLaboratory", named)
    _add(core, "beginPerformanceDate", certificate.performed[0].isoformat())
    _add(core, "endPerformanceDate", certificate.performed[1].isoformat())
    _add(core, "performanceLocation", certificate.settings.performed_at)
    _add(core, "issueDate", certificate.issued_at.date().isoformat())
    if certificate.replaced is not None:
        change = _add(core, "reportAmendedSubstituted")
        _add(change, "typeOfChange", "substituted")
        _add(change, "replacedUniqueIdentifier", certificate.replaced.number)
        previous = _add(core, "previousReport")
        _add_text(previous, "referral", "the certificate that this one replaces, as XML")
        _add(previous, "referralID", certificate.replaced.number)
        _add(previous, "procedure", "SHA-256")
        _add(previous, "value", certificate.replaced.dcc_sha256)


def _add_identifications(parent: Element, issuer: str, named: Iterable[tuple[str, str]]) -> None:
    identifications = _add(parent, "identifications")
    for name, value in named:
        identification = _add(identifications, "identification")
        _add(identification, "issuer", issuer)
        _add(identification, "value", value)
        _add_text(identification, "name", name)


def _add_item(items: Element, certificate: Certificate) -> None:
    sensor = certificate.identity.sensor
    item = _add(items, "item")
    _add_text(item, "name", "Soft pressure sensor, read by electrical impedance tomography")
    _add_text(item, "description", f"{certificate.sensor}; pressed by a head of {certificate.head}")
    _add(item, "model", sensor.sensor_type)
    named = [("serial number", sensor.serial)]
    named += [("batch", sensor.batch)] if sensor.batch else []
    _add_identifications(
        item, "manufacturer", [*named, *((part.name, str(part)) for part in certificate.identity.parts)]
    )


def _add_statements(statements: Element, certificate: Certificate) -> None:
    """Add remarks, the first of which says what was simulated; validity; decision rule with the conformity."""
    for number, remark in enumerate(list_remarks(certificate)):
        _add_statement(statements, "simulation" if number == 0 else "remark", remark)
    _add_statement(statements, "condition", f"verdict of the recipe's limits: {certificate.verdict}")
    if certificate.valid_until is None:
        _add_statement(statements, "validity", NOT_STATED)
    else:
        validity = _add_statement(statements, "validity", "valid until this day")
        _add(validity, "date", certificate.valid_until.isoformat())
    _add_statement(statements, "traceability", describe_traceability(certificate))
    if certificate.replaced is not None:
        _add_statement(statements, "replacement", certificate.replaced.why)
    conformity = _add(statements, "statement")
    _add_text(conformity, "name", "conformity")
    if rule := describe_rule(certificate):
        _add(conformity, "norm", "JCGM 106:2012")
        _add_text(conformity, "declaration", f"{rule} {state_conformity(certificate)}")
    else:
        _add_text(conformity, "declaration", state_conformity(certificate))
    if certificate.outcome:
        _add(conformity, "conformity", certificate.outcome)


def _add_statement(statements: Element, name: str, text: str) -> Element:
    statement = _add(statements, "statement")
    _add_text(statement, "name", name)
    _add_text(statement, "declaration", text)
    return statement


def _add_results(result: Element, certificate: Certificate) -> None:
    _add_text(result, "name", "Force indicated by the sensor")
    methods = _add(result, "usedMethods")
    recipe = _add(methods, "usedMethod")
    _add_text(recipe, "name", f"Recipe {certificate.identity.recipe}")
    _add(recipe, "reference", f"SHA-256 {certificate.recipe_digest}")
    gum = _add(methods, "usedMethod")
    _add_text(gum, "name", "Expanded uncertainty for a coverage probability of about 95 %")
    _add(gum, "norm", "JCGM 100:2008")
    _add_software(_add(result, "usedSoftware"), certificate.identity.software)
    _add_equipment(_add(result, "measuringEquipments"), certificate)
    if certificate.temperature_C is not None:
        condition = _add(_add(result, "influenceConditions"), "influenceCondition")
        _add_text(condition, "name", "Lowest and highest temperature")
        _add_quantity(_add(condition, "data"), "temperature", certificate.temperature_C, r"\degreecelsius")
    results = _add(result, "results")
    _add_forces(results, "Expanded uncertainty of an indicated force", "", certificate.forces)
    in_use = describe_use(certificate)
    _add_forces(results, "Expanded uncertainty of an indicated force in use", in_use, certificate.forces_in_use)
    if certificate.checked:
        _add_checked(results, certificate)


def _add_software(parent: Element, software: Sequence[tuple[str, str]]) -> None:
    for name, version in software:
        used = _add(parent, "software")
        _add_text(used, "name", name)
        _add(used, "release", version)


def _add_equipment(equipment: Element, certificate: Certificate) -> None:
    for standard in certificate.standards:
        element = _add(equipment, "measuringEquipment")
        _add_text(element, "name", standard.role_words)
        _add_text(element, "description", standard.all_words())
        _add_identifications(element, "other", [("calibration certificate", standard.certificate)])
    for instrument in certificate.identity.instruments:
        element = _add(equipment, "measuringEquipment")
        _add_text(element, "name", instrument.role)
        if instrument.model.strip():
            _add(element, "model", instrument.model.strip())
        if instrument.serial.strip():
            _add_identifications(element, "manufacturer", [("serial number", instrument.serial.strip())])


def _add_forces(results: Element, name: str, description: str, forces: Sequence[ExpandedForce]) -> None:
    values = _add_list(results, name, description, forces)
    quantity = _add_quantity(values, "force", [one.force_N for one in forces], r"\newton", forces)
    quantity.set("refType", "basic_measuredValue")


def _add_checked(results: Element, certificate: Certificate) -> None:
    """Add the loads that the calibration was not learned from: reference force, and error with its uncertainty."""
    loads = certificate.checked
    expanded = [load.expanded for load in loads]
    name = "Error at loads that the calibration was not learned from"
    values = _add_list(results, name, describe_checked(certificate), expanded)
    reference = _add_quantity(values, "reference force", [load.reference_N for load in loads], r"\newton")
    reference.set("refType", "basic_referenceValue")
    error = _add_quantity(
        values, "error of the indicated force", [one.error_N for one in loads], r"\newton", expanded
    )
    error.set("refType", "basic_measurementError")
    if certificate.outcome:
        metadata = _add(_add(error, "measurementMetaData"), "metaData")
        _add_text(metadata, "declaration", describe_rule(certificate))
        _add(metadata, "conformityXMLList", " ".join(load.outcome for load in loads))


def _add_list(results: Element, name: str, description: str, forces: Sequence[ExpandedForce]) -> Element:
    """Add a result with the places of its values; return its list."""
    result = _add(results, "result")
    _add_text(result, "name", name)
    if description:
        _add_text(result, "description", description)
    values = _add(_add(result, "data"), "list")
    for axis, label in enumerate(("place x", "place y")):
        _add_quantity(values, label, [force.place_mm[axis] for force in forces], r"\milli\metre")
    return values


def _add_quantity(
    parent: Element, name: str, values: Sequence[float], unit: str, expanded: Sequence[ExpandedForce] = ()
) -> Element:
    """Add values of one unit, with their expanded uncertainties if there are any; return the quantity."""
    quantity = _add(parent, "quantity")
    _add_text(quantity, "name", name)
    if expanded:
        dof = " ".join(f"{one.dof:.4g}" if isfinite(one.dof) else "infinite" for one in expanded)
        missing = ", ".join(list_missing(expanded))
        lacks = f"Expanded uncertainty without: {missing}. " if missing else ""
        _add_text(quantity, "description", f"{lacks}Effective degrees of freedom, in the order of the values: {dof}")
    numbers = SubElement(quantity, f"{{{SI}}}realListXMLList")
    SubElement(numbers, f"{{{SI}}}valueXMLList").text = " ".join(map(repr, map(float, values)))
    SubElement(numbers, f"{{{SI}}}unitXMLList").text = unit
    if expanded:
        uncertainties = SubElement(numbers, f"{{{SI}}}expandedUncXMLList")
        for label, texts in (
            ("uncertaintyXMLList", [repr(float(one.U_N)) for one in expanded]),
            ("coverageFactorXMLList", [repr(float(one.k)) for one in expanded]),
            ("coverageProbabilityXMLList", [_PROBABILITY]),
        ):
            SubElement(uncertainties, f"{{{SI}}}{label}").text = " ".join(texts)
    return quantity
