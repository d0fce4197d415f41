"""Elements of a digital calibration certificate: texts, which are never read as XML, and quantities."""

from collections.abc import Iterable, Sequence
from math import isfinite
from typing import Final
from xml.etree.ElementTree import Element, SubElement

from cbsr_qa.domain.results.expanded_force import ExpandedForce, list_missing

DCC: Final = "https://ptb.de/dcc"
SI: Final = "https://ptb.de/si"
LANGUAGE: Final = "en"
_PROBABILITY: Final = "0.95"


def add_element(parent: Element, name: str, text: str | None = None, **attributes: str) -> Element:
    """Add an element of the DCC, and return it."""
    element = SubElement(parent, f"{{{DCC}}}{name}", attributes)
    element.text = text
    return element


def add_text(parent: Element, name: str, text: str) -> Element:
    """Add an element of the type that holds text in several languages."""
    element = add_element(parent, name)
    add_element(element, "content", text, lang=LANGUAGE)
    return element


def add_identifications(parent: Element, issuer: str, named: Iterable[tuple[str, str]]) -> None:
    """Add identifications, as (name, value); ``issuer`` is who gave them, ``other`` where nothing states that."""
    identifications = add_element(parent, "identifications")
    for name, value in named:
        identification = add_element(identifications, "identification")
        add_element(identification, "issuer", issuer)
        add_element(identification, "value", value)
        add_text(identification, "name", name)


def add_software(parent: Element, software: Iterable[tuple[str, str]]) -> None:
    """Add software, as (name, version)."""
    for name, version in software:
        used = add_element(parent, "software")
        add_text(used, "name", name)
        add_element(used, "release", version)


def add_word(parent: Element, name: str, word: str) -> None:
    """Add a quantity that is one word without blanks."""
    quantity = add_element(parent, "quantity")
    add_text(quantity, "name", name)
    add_element(quantity, "charsXMLList", word)


def add_quantity(
    parent: Element, name: str, values: Sequence[float], unit: str, expanded: Sequence[ExpandedForce] = ()
) -> Element:
    """Add values of one unit, with their expanded uncertainties if there are any; return the quantity."""
    quantity = add_element(parent, "quantity")
    add_text(quantity, "name", name)
    if expanded:
        dof = " ".join(f"{one.dof:.4g}" if isfinite(one.dof) else "infinite" for one in expanded)
        missing = ", ".join(list_missing(expanded))
        lacks = f"Expanded uncertainty without: {missing}. " if missing else ""
        add_text(quantity, "description", f"{lacks}Effective degrees of freedom, in the order of the values: {dof}")
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
