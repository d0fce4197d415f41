"""From a form to the arguments of ``cbsr-qa run``."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

from cbsr_qa.app.gate.request import Override
from cbsr_qa.config.serials import read_parts, validate_batch, validate_operator, validate_serial
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.web.stations import OfferedRecipe, ServedStation


@dataclass(frozen=True, slots=True)
class StartForm:
    """A run that an operator asks for, checked.

    Parameters
    ----------
    parts : parts of the sensor; none if they were not stated.
    pin : PIN of the operator as typed; empty without one.
    again : earlier run of the sensor in spite of which it is tested; empty for none.
    """

    serial: str
    recipe: OfferedRecipe
    operator: str
    batch: str
    override: Override
    parts: tuple[SensorPart, ...] = ()
    pin: str = field(default="", repr=False)
    again: str = ""

    @classmethod
    def from_form(cls, served: ServedStation, form: Mapping[str, str]) -> Self:
        """Check the fields of a form. RefusedError names the first that is not allowed."""
        return cls(
            serial=validate_serial(form.get("serial", "")),
            recipe=served.recipe(form.get("recipe", served.recipes[0].name)),
            operator=validate_operator(form.get("operator", "")),
            batch=validate_batch(form.get("batch", "")),
            override=Override(
                tuple(form.get("override", "").split()),
                form.get("override_by", ""),
                form.get("override_why", ""),
            ).validate(),
            parts=split_parts(form.get("parts", "")),
            pin=form.get("pin", ""),
            again=form.get("again", ""),
        )

    @property
    def fields(self) -> dict[str, str]:
        """The fields of a form that asks for the same, without the PIN and the consent to another test."""
        return {
            "serial": self.serial,
            "recipe": self.recipe.name,
            "operator": self.operator,
            "batch": self.batch,
            "parts": ", ".join(map(str, self.parts)),
            "override": " ".join(self.override.checks),
            "override_by": self.override.by,
            "override_why": self.override.why,
        }

    def arguments(self, served: ServedStation, database: str | None) -> list[str]:
        """Return the arguments of ``cbsr-qa run``."""
        return [
            f"--station={served.source}",
            f"--recipe={self.recipe.source}",
            f"--serial={self.serial}",
            f"--operator={self.operator}",
            f"--batch={self.batch}",
            *(f"--part={part}" for part in self.parts),
            *(f"--override={check}" for check in self.override.checks),
            *([f"--override-by={self.override.by}"] if self.override.checks else []),
            *([f"--override-why={self.override.why}"] if self.override.checks else []),
            *common_arguments(database),
        ]


def split_parts(text: str) -> tuple[SensorPart, ...]:
    """Return the parts of a field, separated by commas. ConfigError if one cannot be used, or is given twice."""
    return read_parts([part.strip() for part in text.split(",") if part.strip()])


def find_wrong_field(form: Mapping[str, str]) -> str:
    """Return the field of a form that cannot be used; empty if none, or if the serial number cannot."""
    checks = {"serial": validate_serial, "operator": validate_operator, "batch": validate_batch, "parts": split_parts}
    for field_name, check in checks.items():
        try:
            check(form.get(field_name, ""))
        except ConfigError:
            return "" if field_name == "serial" else field_name
    return ""


def resume_arguments(served: ServedStation, run: str, operator: str, database: str | None) -> list[str]:
    """Return the arguments of ``cbsr-qa run`` that resume a run; the gate reads the station's file as it is now."""
    return [f"--resume={run}", f"--station={served.source}", f"--operator={operator}", *common_arguments(database)]


def common_arguments(database: str | None) -> list[str]:
    """Return the arguments of every run that a page starts."""
    return ["--prompts=channel", *([] if database is None else [f"--database={database}"])]
