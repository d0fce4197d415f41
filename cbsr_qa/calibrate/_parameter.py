"""The regularisation parameter among the entries of a calibration file.

Files of before say only value and reason. The name is then the one their method gives it, and nobody says the
criterion. A choice that says no more than that is written as it was then, so that what was issued before keeps its
digests.
"""

from typing import Final

from cbsr_qa.calibrate._content import Reading, Writing
from cbsr_qa.domain.reconstruction import ParameterChoice

_AT: Final = "reconstruction/regularisation"
_NAME: Final = f"{_AT}_name"
_CRITERION: Final = f"{_AT}_criterion"

#: What methods call their parameter where a file does not; every other one has a λ.
_CALLED: Final = {
    "truncated-svd": "components kept",
    "linear-back-projection": "no parameter",
    "pyeit-jac": "pyEIT's lamb",
    "pyeit-greit": "pyEIT's lamb",
}


def write_choice(out: Writing, method: str, choice: ParameterChoice) -> None:
    """Keep a method's choice."""
    out.number(_AT, choice.value)
    out.text(f"{_AT}_how", choice.how)
    out.number("reconstruction/noise_figure", choice.noise_figure)
    if choice.criterion or choice.name != _implied(method):
        out.text(_NAME, choice.name)
        out.text(_CRITERION, choice.criterion)


def read_choice(read: Reading, method: str) -> ParameterChoice:
    """Return a method's choice; CalibrationError where an entry is missing or of another type."""
    named = read.has(_NAME) or read.has(_CRITERION)
    return ParameterChoice(
        read.number(_AT),
        read.text(f"{_AT}_how"),
        read.number("reconstruction/noise_figure"),
        read.text(_NAME) if named else _implied(method),
        criterion=read.text(_CRITERION) if named else "",
    )


def _implied(method: str) -> str:
    return _CALLED.get(method, "λ")
