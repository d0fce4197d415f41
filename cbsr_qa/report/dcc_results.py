"""What was measured, as a digital calibration certificate states it: method, instruments, conditions, results."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

from cbsr_qa.domain.plan.standards import StandardRole, find_standard
from cbsr_qa.domain.results.certificate import NOT_MEASURED, NOT_STATED, Certificate
from cbsr_qa.domain.results.expanded_force import ExpandedForce
from cbsr_qa.report.certificate_texts import (
    ABOUT_ERRORS,
    ABOUT_UNCERTAINTIES,
    PROCEDURE,
    describe_checked,
    describe_day,
    describe_results,
    describe_rule,
    describe_use,
)
from cbsr_qa.report.dcc_elements import (
    add_element,
    add_identifications,
    add_quantity,
    add_software,
    add_text,
)


def add_results(result: Element, certificate: Certificate) -> None:
    """Fill the measurement result of a certificate."""
    add_text(result, "name", "Force indicated by the sensor")
    add_text(result, "description", describe_results(certificate))
    _add_methods(add_element(result, "usedMethods"), certificate)
    add_software(add_element(result, "usedSoftware"), certificate.identity.software)
    _add_equipment(add_element(result, "measuringEquipments"), certificate)
    _add_conditions(add_element(result, "influenceConditions"), certificate)
    results = add_element(result, "results")
    _add_forces(results, "Expanded uncertainty of an indicated force", describe_day(certificate), certificate.forces)
    in_use = describe_use(certificate)
    _add_forces(results, "Expanded uncertainty of an indicated force in use", in_use, certificate.forces_in_use)
    _add_checked(results, certificate)
    _add_validity(add_element(result, "measurementMetaData"), certificate)


def _add_methods(methods: Element, certificate: Certificate) -> None:
    recipe = add_element(methods, "usedMethod")
    add_text(recipe, "name", f"Recipe {certificate.identity.recipe}")
    add_text(recipe, "description", PROCEDURE)
    add_element(recipe, "reference", f"SHA-256 of the recipe {certificate.recipe_digest}")
    add_element(recipe, "reference", f"SHA-256 of all settings {certificate.identity.configuration_digest}")
    gum = add_element(methods, "usedMethod")
    add_text(gum, "name", "Expanded uncertainty for a coverage probability of about 95 %")
    add_text(gum, "description", ABOUT_UNCERTAINTIES)
    add_element(gum, "norm", "JCGM 100:2008")


def _add_equipment(equipment: Element, certificate: Certificate) -> None:
    """Add every role of a standard, stated or not, and the instruments of the station."""
    for role in StandardRole:
        element, standard = add_element(equipment, "measuringEquipment"), find_standard(certificate.standards, role)
        add_text(element, "name", f"{str(role).replace('_', ' ')}, standard")
        add_text(element, "description", NOT_STATED if standard is None else standard.all_words())
        if standard is not None:
            add_identifications(element, "other", [("calibration certificate", standard.certificate)])
    for instrument in certificate.identity.instruments:
        element = add_element(equipment, "measuringEquipment")
        add_text(element, "name", instrument.role)
        if model := instrument.model.strip():
            add_element(element, "model", model)
        else:
            add_text(element, "description", f"model {NOT_STATED}")
        if serial := instrument.serial.strip():
            add_identifications(element, "other", [("serial number", serial)])


def _add_conditions(conditions: Element, certificate: Certificate) -> None:
    for name, measured_C in (("Lowest and highest temperature", certificate.temperature_C), ("Humidity", None)):
        condition = add_element(conditions, "influenceCondition")
        add_text(condition, "name", name)
        data = add_element(condition, "data")
        if measured_C is None:
            add_text(data, "text", NOT_MEASURED)
        else:
            add_quantity(data, "temperature", measured_C, r"\degreecelsius")


def _add_forces(results: Element, name: str, about: str, forces: Sequence[ExpandedForce]) -> None:
    values = _add_list(results, name, about, forces)
    quantity = add_quantity(values, "force", [one.force_N for one in forces], r"\newton", forces)
    quantity.set("refType", "basic_measuredValue")


def _add_checked(results: Element, certificate: Certificate) -> None:
    """Add the loads that the calibration was not learned from: reference and indicated force, error, its limit."""
    loads, name = certificate.checked, "Error at loads that the calibration was not learned from"
    if not loads:
        result = add_element(results, "result")
        add_text(result, "name", name)
        add_text(add_element(result, "data"), "text", describe_checked(certificate))
        return
    expanded = [load.expanded for load in loads]
    values = _add_list(results, name, f"{describe_checked(certificate)} {ABOUT_ERRORS}.", expanded)
    reference = add_quantity(values, "reference force", [load.reference_N for load in loads], r"\newton")
    reference.set("refType", "basic_referenceValue")
    indicated = add_quantity(values, "indicated force", [one.indicated_N for one in loads], r"\newton")
    indicated.set("refType", "basic_measuredValue")
    error = add_quantity(values, "error of the indicated force", [one.error_N for one in loads], r"\newton", expanded)
    error.set("refType", "basic_measurementError")
    if certificate.outcome:
        limits_N = [load.max_error_N for load in loads if load.max_error_N is not None]
        add_quantity(values, "maximum permissible error", limits_N, r"\newton")
        metadata = add_element(add_element(error, "measurementMetaData"), "metaData")
        add_text(metadata, "declaration", describe_rule(certificate))
        add_element(metadata, "conformityXMLList", " ".join(load.outcome for load in loads))


def _add_list(results: Element, name: str, about: str, forces: Sequence[ExpandedForce]) -> Element:
    """Add a result with the places of its values; return its list."""
    result = add_element(results, "result")
    add_text(result, "name", name)
    if about:
        add_text(result, "description", about)
    values = add_element(add_element(result, "data"), "list")
    for axis, label in enumerate(("place x", "place y")):
        add_quantity(values, label, [force.place_mm[axis] for force in forces], r"\milli\metre")
    return values


def _add_validity(metadata: Element, certificate: Certificate) -> None:
    """Add in numbers for which loads the results hold, as the description of the result says in words."""
    element = add_element(metadata, "metaData")
    add_text(element, "name", "loads for which the results hold")
    data = add_element(element, "data")
    add_quantity(data, "time after the press", [certificate.forces[0].settling_s], r"\second")
    add_quantity(data, "least and largest force", certificate.range_N, r"\newton")
    add_quantity(data, "distance from the centre of the sheet", [certificate.radius_mm], r"\milli\metre")
