"""Regions of images, and their metrics."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .blobs import (
        AnyRegion as AnyRegion,
        find_blobs as find_blobs,
        find_blobs_by_mask as find_blobs_by_mask,
        nearest_blob as nearest_blob,
        noise_floor as noise_floor,
        percentage_mask as percentage_mask,
        subtract_noise_floor as subtract_noise_floor,
    )
    from .contours import contour_regions as contour_regions, find_contours_by_mask as find_contours_by_mask
    from .multi_load import (
        Assignment as Assignment,
        assign_regions as assign_regions,
        split_blobs as split_blobs,
        two_touch_resolution as two_touch_resolution,
    )
    from .rasters import (
        Raster as Raster,
        find_regions as find_regions,
        pixel_image as pixel_image,
        split_touching as split_touching,
    )
    from .registration import Registration as Registration, register as register
    from .shape import (
        GreitFigures as GreitFigures,
        SpatialFigures as SpatialFigures,
        area_overlap_percent as area_overlap_percent,
        centre_of_mass_error_mm as centre_of_mass_error_mm,
        greit_figures as greit_figures,
        overlap_grade as overlap_grade,
        shape_deviation_mm2 as shape_deviation_mm2,
        spatial_figures as spatial_figures,
    )

door(__name__, __file__)
