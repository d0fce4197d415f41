"""The qualifier of a measurement as typed dimensions, parsed and written only here."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Self

_NUMBER: Final = r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)"


@dataclass(frozen=True, slots=True)
class Dimensions:
    """Dimensions of a measurement beside phase, location, trial and load; None or empty for what it does not have.

    Parameters
    ----------
    words : parts that have no type: a kind (``"watershed"``), a signal (``"image"``), a place of a simulated target.
    direction : ``"loading"`` or ``"unloading"``.
    target_mm : diameter of a simulated target; its text has three digits.
    mask : percentage mask as a fraction; None also for the run's main mask.
    pair : electrodes of a pair.
    drive, measure : row and column of a reading.
    strain : strain as a fraction.
    reference : reference that a load was compared with instead of the recipe's choice.
    """

    words: str = ""
    direction: str = ""
    target_mm: float | None = None
    mask: float | None = None
    pair: tuple[int, int] | None = None
    drive: int | None = None
    measure: int | None = None
    strain: float | None = None
    reference: str = ""

    @classmethod
    def from_qualifier(cls, qualifier: str) -> Self:
        """Read a qualifier; parts of no known form are its words."""
        untyped_parts: list[str] = []
        value_by_name: dict[str, Any] = {}
        for part in filter(None, qualifier.split(", ")):
            for name, (pattern, value, _) in _PARTS.items():
                if (match := re.fullmatch(pattern, part)) and name not in value_by_name:
                    value_by_name[name] = value(*match.groups())
                    break
            else:
                untyped_parts.append(part)
        return cls(", ".join(untyped_parts), **value_by_name)

    @property
    def text(self) -> str:
        """The qualifier, as it is stored, printed and matched by limits."""
        value_by_name = {name: getattr(self, name) for name in _PARTS}
        parts = [
            write(value_by_name[name])
            for name, (_, _, write) in _PARTS.items()
            if value_by_name[name] not in ("", None)
        ]
        return ", ".join(filter(None, (self.words, *parts)))


def _fraction(percent: str) -> float:
    return float(percent) / 100


#: Dimension → its pattern in a qualifier, what reads the pattern's groups, and what writes it; in their order.
_PARTS: Final[dict[str, tuple[str, Callable[..., Any], Callable[[Any], str]]]] = {
    "direction": ("(loading|unloading)", str, str),
    "target_mm": (f"target of {_NUMBER} mm", float, "target of {:.3g} mm".format),
    "mask": (f"mask {_NUMBER} %", _fraction, lambda fraction: f"mask {100 * fraction:g} %"),
    "pair": (r"pair (\d+)-(\d+)", lambda *pair: tuple(map(int, pair)), lambda pair: "pair {}-{}".format(*pair)),
    "drive": (r"drive (\d+)", int, "drive {}".format),
    "measure": (r"measure (\d+)", int, "measure {}".format),
    "strain": (f"{_NUMBER} % strain", _fraction, lambda fraction: f"{100 * fraction:g} % strain"),
    "reference": ("reference (.+)", str, "reference {}".format),
}
