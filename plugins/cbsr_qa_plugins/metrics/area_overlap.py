"""A_OL: mutual overlap of sensed region and indenter (paper Eq 5), with the band it falls into."""

from typing import Any, ClassVar

from cbsr_qa.domain.image import Blob, Region
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, MaskView, RunObservation
from cbsr_qa.domain.plan import AnalysisSettings
from cbsr_qa.imaging.overlap_bands import overlap_grade
from cbsr_qa.imaging.shape import area_overlap_percent
from cbsr_qa_plugins.metrics._shared import at_load, masks_of, refuse_unknown, why_not


class AreaOverlap:
    """``area_overlap`` [%] and ``area_ratio`` A_b/A_FA of every load, for every percentage mask.

    Both ``how`` begin with the band, e.g. ``"good; A_b/A_FA 1.02; exact clipping"``. Clipping, bands and the
    sizes for which they count are the recipe's analysis settings; there are no options.
    """

    measures: ClassVar[dict[str, str]] = {"area_overlap": "%", "area_ratio": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("area-overlap", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure the sensed blob under each mask; without a blob there is no value."""
        measured: list[Measurement] = []
        for view, qualifier in masks_of(load, run):
            overlap, ratio, how = _measure(view, load, run.settings)
            measured.append(at_load(load, "area_overlap", overlap, "%", qualifier=qualifier, how=how))
            measured.append(at_load(load, "area_ratio", ratio, "1", qualifier=qualifier, how=how))
        return tuple(measured)


def _measure(
    view: MaskView, load: LoadObservation, settings: AnalysisSettings
) -> tuple[float | None, float | None, str]:
    if view.region is None:
        return None, None, why_not(view)
    place, region = load.record.load, view.region
    overlap = area_overlap_percent(region, load.indenter.at(place.x_mm, place.y_mm), settings.clipping)
    ratio = region.area_mm2 / load.indenter.area_mm2
    grade = overlap_grade(overlap, ratio, bands=settings.overlap_bands, size_ratio=settings.size_ratio)
    return overlap, ratio, f"{grade}; A_b/A_FA {ratio:.2f}; {_clipped(region, settings)}"


def _clipped(region: Region, settings: AnalysisSettings) -> str:
    return f"{settings.clipping} clipping of {'elements' if isinstance(region, Blob) else 'a contour'}"
