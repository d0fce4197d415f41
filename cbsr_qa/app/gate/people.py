"""The operator: on the station's list, with the right PIN."""

import unicodedata

from cbsr_qa.app.gate.request import Asked, Finding, GateRequest
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy, GateSettings, Operator
from cbsr_qa.system.pins import pin_matches

_REMEDY = ("name an operator of the station's list", "--operator NAME")
_TYPED = "at the terminal, or as the first line of standard input"


def operator_known(asked: Asked) -> Finding:
    """Look the operator up in the list, and compare the PIN where there is one."""
    request, listed = asked.request, asked.settings.operators
    name = request.operator
    if request.resumed and not listed:
        # A run is not stored with the list of who may work at the station.
        return Finding(
            False, "the list of operators is not stored with a run", "give the station's file", "--station FILE"
        )
    if not name:
        return Finding(False, "no operator was named", *_REMEDY)
    operator = _find_operator(asked.settings, name)
    if operator is None:
        return Finding(False, f"{name} is not on the list of operators", *_REMEDY)
    return _pin_finding(request, operator)


def _pin_finding(request: GateRequest, known: Operator) -> Finding:
    name, on_list = known.name, f"{known.name} is on the list of operators"
    if not known.pin:
        return Finding(True, on_list)
    if request.preview:
        return Finding(True, f"{on_list}; the PIN is asked for when the run begins")
    pin = "" if request.pin is None else request.pin(f"PIN of {name}")
    if not pin:
        return Finding(False, f"the PIN of {name} was not given", "type it", _TYPED)
    if not pin_matches(pin, known.pin):
        return Finding(
            False, f"the PIN given is not that of {name}", "type it again, or name another operator", _TYPED
        )
    return Finding(True, f"{on_list}, and gave the PIN")


def asks_pin(settings: GateSettings, operator: str) -> bool:
    """Whether a run of this operator asks for a PIN."""
    known_operator = _find_operator(settings, operator)
    return (
        settings.policy(GateCheck.OPERATOR) is not GatePolicy.OFF
        and known_operator is not None
        and bool(known_operator.pin)
    )


def is_pin_of(settings: GateSettings, operator: str, pin: str) -> bool:
    """Whether a PIN is that of a listed operator, who has one."""
    known_operator = _find_operator(settings, operator)
    return known_operator is not None and bool(known_operator.pin) and pin_matches(pin, known_operator.pin)


def _find_operator(settings: GateSettings, name: str) -> Operator | None:
    wanted = unicodedata.normalize("NFC", name)
    return next((one for one in settings.operators if unicodedata.normalize("NFC", one.name) == wanted), None)
