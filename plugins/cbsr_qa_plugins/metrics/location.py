"""Metrics of a load's place, size and shape, from its image and from the readings themselves.

E_CoM is the distance of the sensed region's centre of mass from the indenter's centre (paper Eq 4), A_OL the mutual
overlap of both (Eq 5) and SD the mean squared distance of the region's outline from the indenter's (Eq 6).
"""

from math import dist
from typing import ClassVar

from cbsr_qa.analysis.run.estimates import estimate_loads
from cbsr_qa.eit.imaging.shape import (
    area_overlap_percent,
    centre_of_mass_error_mm,
    overlap_grade,
    shape_deviation_mm2,
)
from cbsr_qa.plugin import (
    Blob,
    Estimated,
    LoadEstimate,
    LoadObservation,
    Measurement,
    RunObservation,
)
from cbsr_qa_plugins.metrics._shared import masks_of, measurement_of_load, why_not


class CentreOfMassError:
    """``centre_of_mass_error`` [mm] of every load, for every percentage mask.

    It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"centre_of_mass_error": "mm"}

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure the sensed blob under each mask; without a blob there is no value."""
        measured: list[Measurement] = []
        for view, qualifier in masks_of(load, run):
            value, how = None, why_not(view)
            if view.region is not None:
                value = centre_of_mass_error_mm(view.region, load.pressed)
                how = "area- and value-weighted centre of mass"
            measured.append(
                measurement_of_load(load, "centre_of_mass_error", value, "mm", qualifier=qualifier, how=how)
            )
        return tuple(measured)


class AreaOverlap:
    """``area_overlap`` [%], limited only together with ``area_ratio`` A_b/A_FA, of every load under every mask.

    Both ``how`` begin with the band, e.g. ``"band good; A_b/A_FA 1.02; exact clipping"``. Clipping, bands and the
    sizes for which they count are the recipe's analysis settings; there are no options.
    """

    measures: ClassVar[dict[str, str]] = {"area_overlap": "%", "area_ratio": "1"}

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure the sensed blob under each mask; without a blob there is no value."""
        measured: list[Measurement] = []
        for view, qualifier in masks_of(load, run):
            overlap, ratio, how = None, None, why_not(view)
            if view.region is not None:
                overlap = area_overlap_percent(view.region, load.pressed, run.settings.clipping)
                ratio = view.region.area_mm2 / load.indenter.area_mm2
                grade = overlap_grade(
                    overlap, ratio, bands=run.settings.overlap_bands, size_ratio=run.settings.size_ratio
                )
                clipped = "elements" if isinstance(view.region, Blob) else "a contour"
                how = f"band {grade}; A_b/A_FA {ratio:.2f}; {run.settings.clipping} clipping of {clipped}"
            measured.append(measurement_of_load(load, "area_overlap", overlap, "%", qualifier=qualifier, how=how))
            measured.append(measurement_of_load(load, "area_ratio", ratio, "1", qualifier=qualifier, how=how))
        return tuple(measured)


class ShapeDeviation:
    """``shape_deviation`` [mm²] of every load, for every percentage mask.

    Never to be judged alone: a speck on the indenter's rim deviates by 0.2 mm² at an E_CoM of 6.5 mm.
    The mean runs over the outline's length or its nodes, as the recipe's analysis settings say; there are no
    options.
    """

    measures: ClassVar[dict[str, str]] = {"shape_deviation": "mm²"}

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure the sensed blob under each mask; without a blob there is no value."""
        mode = run.settings.perimeter
        measured: list[Measurement] = []
        for view, qualifier in masks_of(load, run):
            value, how = None, why_not(view)
            if view.region is not None:
                value = shape_deviation_mm2(view.region, load.pressed, mode)
                how = f"mean over the outline's {mode}"
            measured.append(measurement_of_load(load, "shape_deviation", value, "mm²", qualifier=qualifier, how=how))
        return tuple(measured)


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

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; loads held together with others are not estimated."""
        chosen = run.settings.reference
        own = any(load is mine for mine in run.loads)  # else it is a load's alternate, against the other reference
        other = "load" if chosen == "run" else "run"
        estimate = estimate_loads(run, chosen if own else other)[(load.phase, load.record.index)]
        placed = estimate.indenter or estimate.size
        if placed is None:
            return tuple(
                measurement_of_load(load, name, None, unit, how=estimate.why) for name, unit in self.measures.items()
            )
        size = estimate.size or placed
        no_contrast = placed.why or "the head is not round: only area × contrast is estimated"
        unknown = "radius unknown; contrast against the mean of both conductances"
        return (
            _place_error(load, placed),
            _report_estimate(load, "estimated_contrast", placed.contrast, "indenter's radius given", no_contrast),
            _report_estimate(load, "estimated_radius", size.radius_mm, "radius unknown", size.no_radius or size.why),
            _report_estimate(load, "estimated_area_contrast", size.area_contrast_mm2, unknown, size.why),
            measurement_of_load(load, "detectability", placed.detectability, "1", uncertainty=1.0, how=_fit(placed)),
        )


def _place_error(load: LoadObservation, placed: LoadEstimate) -> Measurement:
    name, unit = "estimated_place_error", "mm"
    if placed.place_mm is None:
        return measurement_of_load(load, name, None, unit, how=placed.why)
    x_mm, y_mm = placed.place_mm
    where = f"{x_mm:.2f}, {y_mm:.2f}".replace("-", "−")
    how = f"seen at ({where}) mm; {_fit(placed)}"
    error_mm, stderr_mm = dist(placed.place_mm, load.place_mm), placed.place_stderr_mm
    return measurement_of_load(load, name, error_mm, unit, uncertainty=stderr_mm, how=how)


def _report_estimate(load: LoadObservation, name: str, estimate: Estimated | None, how: str, why: str) -> Measurement:
    unit = LoadEstimates.measures[name]
    if estimate is None:
        return measurement_of_load(load, name, None, unit, how=why)
    return measurement_of_load(load, name, estimate.value, unit, uncertainty=estimate.stderr, how=how)


def _fit(placed: LoadEstimate) -> str:
    widened = f", covariance × {placed.inflation:.2g} for it" if placed.inflation > 1 else ""
    explained = f"{placed.explained:.1%} of the signal explained ({placed.explained_unweighted:.1%} unweighted)"
    return f"{placed.finding}; {explained}; residuals {placed.misfit:.2f} of the noise{widened}"
