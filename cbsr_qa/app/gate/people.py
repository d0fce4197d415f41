"""The operator: on the station's list, with the right PIN."""

import unicodedata

from cbsr_qa.app.gate.request import Asked, Finding, GateRequest
from cbsr_qa.domain.plan import Operator
from cbsr_qa.system import pin_matches

_REMEDY = "give --operator NAME with a name of the station's list"


def operator_known(asked: Asked) -> Finding:
    """Look the operator up in the list, and compare the PIN where there is one."""
    request, listed = asked.request, asked.settings.operators
    name = request.operator
    if request.resumed and not listed:
        # A run is not stored with the list of who may work at the station.
        return Finding(
            False, "the list of operators is not stored with a run", "give the station file with --station"
        )
    if not name:
        return Finding(False, "no operator was named", _REMEDY)
    known = next((one for one in listed if _same(one.name, name)), None)
    if known is None:
        return Finding(False, f"{name} is not on the list of operators", _REMEDY)
    return _pin_finding(request, known)


def _pin_finding(request: GateRequest, known: Operator) -> Finding:
    name, on_list = known.name, f"{known.name} is on the list of operators"
    if not known.pin:
        return Finding(True, on_list)
    if request.preview:
        return Finding(True, f"{on_list}; the PIN is asked for when the run begins")
    pin = "" if request.pin is None else request.pin(f"PIN of {name}")
    if not pin:
        return Finding(False, f"the PIN of {name} was not given", "type it when asked, or on standard input")
    if not pin_matches(pin, known.pin):
        return Finding(False, f"the PIN given is not that of {name}", "type it again, or name another operator")
    return Finding(True, f"{on_list}, and gave the PIN")


def _same(one: str, other: str) -> bool:
    return unicodedata.normalize("NFC", one) == unicodedata.normalize("NFC", other)
