"""The five figures of merit of GREIT (Adler et al. 2009) on every load's image."""

from dataclasses import astuple
from typing import Any, ClassVar, Final

from cbsr_qa.domain.image import Image
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.sensor import Response
from cbsr_qa.imaging.greit_figures import GreitFigures, greit_figures
from cbsr_qa_plugins.metrics._shared import at_load, refuse_unknown

_NAMES: Final = ("amplitude_response", "position_error", "resolution", "shape_deformation", "ringing")


class GreitFiguresOfMerit:
    """AR, PE [mm], RES, SD and RNG [1] of each load's steady image, nothing subtracted from it.

    The amplitude response is against the head's area times the change that the material file expects at the load's
    strain. The set q is what reaches a quarter of the maximum. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {name: "mm" if name == "position_error" else "1" for name in _NAMES}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("greit-figures", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; an image without a positive element has no figures."""
        sign = -1.0 if load.response is Response.DECREASE else 1.0
        place, expected = load.record.load, _expected(load, run)
        target = load.indenter.at(place.x_mm, place.y_mm)
        found = greit_figures(
            Image(load.image.mesh, sign * load.image.values), target, contrast=expected if expected > 0 else None
        )
        return tuple(
            at_load(load, name, value, unit, how=_how(name, found, expected))
            for (name, unit), value in zip(
                self.measures.items(), (None,) * len(_NAMES) if found is None else astuple(found), strict=True
            )
        )


def _expected(load: LoadObservation, run: RunObservation) -> float:
    """Size of the relative change that the material file expects under the head."""
    known = run.record.material.against_strain
    return abs(known.slope.value * load.record.load.strain + known.intercept.value)


def _how(name: str, found: GreitFigures | None, expected: float) -> str:
    if found is None:
        return "not detected: no element of the image has the sign of the response"
    if name == "amplitude_response":
        return f"against {100 * expected:.3g} % over the head's area" if expected > 0 else "no change is expected"
    if name == "ringing" and found.ringing is None:
        return "the image's quarter amplitude set has nothing at its centre"
    return "of the set above a quarter of the maximum"
