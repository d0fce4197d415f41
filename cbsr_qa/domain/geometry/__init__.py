"""Outlines, polygons and footprints, with exact areas and distances."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .curve import (
        ClosedCurve as ClosedCurve,
        circle_curve as circle_curve,
        corner_turns as corner_turns,
        polygon_curve as polygon_curve,
        rounding_room as rounding_room,
    )
    from .footprints import (
        Footprint as Footprint,
        PolygonFootprint as PolygonFootprint,
        RoundFootprint as RoundFootprint,
        overlap_mm2 as overlap_mm2,
    )
    from .outlines import (
        MOST_CORNERS as MOST_CORNERS,
        Disc as Disc,
        Polygon as Polygon,
        SheetOutline as SheetOutline,
        polygon_problems as polygon_problems,
        rounding_problems as rounding_problems,
        simplified as simplified,
        thinned_ring as thinned_ring,
    )
    from .polygons import (
        circle_overlap_mm2 as circle_overlap_mm2,
        inside_edges as inside_edges,
        inside_polygon as inside_polygon,
        signed_area as signed_area,
    )

door(__name__, __file__)
