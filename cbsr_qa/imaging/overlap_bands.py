"""Bands of the area overlap, and when they count."""

from collections.abc import Sequence
from typing import Final

from cbsr_qa.domain.calibration import OverlapBand

#: The paper's scale, [lower, upper) percent. Clipping can round a perfect overlap to just above 100.
DEFAULT_BANDS: Final = (
    OverlapBand("likely poor", 0.0, 50.0),
    OverlapBand("ok", 50.0, 70.0),
    OverlapBand("good", 70.0, 100.0),
)

#: Lowest and highest A_b/A_FA for which a band counts.
DEFAULT_SIZE_RATIO: Final = (1 / 3, 3.0)

#: Grade of a blob whose size makes its overlap meaningless: one over the whole sheet, or one speck, scores 50 %.
WRONG_SIZE: Final = "likely poor: size"


def overlap_grade(
    overlap_percent: float,
    area_ratio: float,
    *,
    bands: Sequence[OverlapBand] = DEFAULT_BANDS,
    size_ratio: tuple[float, float] = DEFAULT_SIZE_RATIO,
) -> str:
    """Name the band of an area overlap, or say that the blob's size makes it meaningless.

    Parameters
    ----------
    overlap_percent : A_OL [%].
    area_ratio : A_b/A_FA.
    bands : [lower, upper) each; the highest band includes its upper end.
    size_ratio : both ends inclusive.

    Returns
    -------
    The band's name, ``"likely poor: size"``, or ``"no band"`` where the bands leave a gap.
    """
    lowest, highest = size_ratio
    if not lowest <= area_ratio <= highest:
        return WRONG_SIZE
    top = max(band.upper for band in bands)
    for band in bands:
        if band.lower <= overlap_percent < band.upper or (band.upper == top and overlap_percent >= top):
            return band.name
    return "no band"
