"""Place, size and strength of every load estimated from the readings, beside the metrics of its image."""

from math import hypot
from typing import Any, ClassVar

from cbsr_qa.analysis.run_estimates import EstimatedLoad, estimated_loads
from cbsr_qa.domain.load_estimate import Estimated, LoadEstimate
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa_plugins.metrics._shared import at_load, refuse_unknown


class LoadEstimates:
    """Estimates of every load by maximum likelihood on its readings, each with its standard error.

    ``estimated_place_error`` [mm] (distance from the indenter's centre; its uncertainty is the place's standard error
    along one axis), ``estimated_contrast`` [1] and ``detectability`` [1] with the indenter's radius given;
    ``estimated_radius`` [mm] and ``estimated_area_contrast`` [mm²] without. What the readings do not determine has no
    value, and ``how`` says what is missing. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {
        "estimated_place_error": "mm",
        "estimated_contrast": "1",
        "estimated_radius": "mm",
        "estimated_area_contrast": "mm²",
        "detectability": "1",
    }

    def __init__(self, **options: Any) -> None:
        refuse_unknown("load-estimate", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; loads held together with others are not estimated."""
        chosen = run.settings.reference
        own = any(load is one for one in run.loads)  # else it is a load's alternate, against the other reference
        other = "load" if chosen == "run" else "run"
        found = estimated_loads(run, chosen if own else other)[(load.phase, load.record.index)]
        placed = found.indenter or found.size
        if placed is None:
            return tuple(at_load(load, name, None, unit, how=found.why) for name, unit in self.measures.items())
        return (_place_error(load, placed), *_strength(load, found, placed), _seen(load, placed))


def _place_error(load: LoadObservation, placed: LoadEstimate) -> Measurement:
    name, unit = "estimated_place_error", "mm"
    if placed.place_mm is None:
        return at_load(load, name, None, unit, how=placed.why)
    x_mm, y_mm = placed.place_mm
    wanted = load.record.load
    error = hypot(x_mm - wanted.x_mm, y_mm - wanted.y_mm)
    where = f"{x_mm:.2f}, {y_mm:.2f}".replace("-", "−")
    how = f"seen at ({where}) mm; {_fit(placed)}"
    return at_load(load, name, error, unit, uncertainty=placed.place_stderr_mm, how=how)


def _strength(load: LoadObservation, found: EstimatedLoad, placed: LoadEstimate) -> tuple[Measurement, ...]:
    size = found.size or placed
    no_contrast = placed.why or "the head is not round: only area × contrast is estimated"
    return (
        _estimated(load, "estimated_contrast", "1", placed.contrast, "indenter's radius given", no_contrast),
        _estimated(load, "estimated_radius", "mm", size.radius_mm, "radius unknown", size.no_radius or size.why),
        _estimated(
            load, "estimated_area_contrast", "mm²", size.area_contrast_mm2,
            "radius unknown; contrast against the mean of both conductances", size.why,
        ),
    )  # fmt: skip


def _estimated(
    load: LoadObservation, name: str, unit: str, found: Estimated | None, how: str, why: str
) -> Measurement:
    if found is None:
        return at_load(load, name, None, unit, how=why)
    return at_load(load, name, found.value, unit, uncertainty=found.stderr, how=how)


def _seen(load: LoadObservation, placed: LoadEstimate) -> Measurement:
    return at_load(load, "detectability", placed.detectability, "1", uncertainty=1.0, how=_fit(placed))


def _fit(placed: LoadEstimate) -> str:
    widened = f", covariance × {placed.inflation:.2g} for it" if placed.inflation > 1 else ""
    return f"{placed.finding}; residuals {placed.misfit:.2f} of the noise{widened}"
