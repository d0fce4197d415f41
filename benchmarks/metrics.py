"""Masks, blobs and metrics of one image, against the loop over elements one would write first."""

from collections.abc import Iterator

import numpy as np

from benchmarks.rows import Row, ratio_row
from benchmarks.timing import compare
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.footprints import RoundFootprint
from cbsr_qa.domain.image import Image
from cbsr_qa.forward.meshing import image_mesh
from cbsr_qa.imaging.blobs import find_blobs, nearest_blob
from cbsr_qa.imaging.masks import percentage_mask
from cbsr_qa.imaging.shape import area_overlap_percent, centre_of_mass_error_mm, shape_deviation_mm2

_PLACE = (15.0, 15.0)
_RADIUS_MM = 6.5
_HEAD = RoundFootprint(*_PLACE, _RADIUS_MM)


TITLE = "Figures of merit"


def rows() -> Iterator[Row]:
    """Four masks with all three metrics, against one circle mask by a loop over the elements."""
    mesh = image_mesh(load_sensor_type("disc-100mm").value, size_mm=2.2)
    away = np.hypot(*(mesh.centroids_mm - np.array(_PLACE)).T)
    image = Image(mesh, np.exp(-((away / 9.0) ** 2)))

    def four_masks() -> None:
        for fraction in (0.25, 0.5, 0.75, 0.85):
            blob = nearest_blob(find_blobs(image, percentage_mask(image.values, fraction)), *_PLACE)
            assert blob is not None
            centre_of_mass_error_mm(blob, _HEAD)
            area_overlap_percent(blob, _HEAD)
            shape_deviation_mm2(blob, _HEAD)

    def circle_mask() -> list[int]:
        inside = []
        for number, element in enumerate(mesh.elements):
            centre = mesh.nodes_mm[element].mean(axis=0)
            if np.linalg.norm(centre - _PLACE) <= _RADIUS_MM:
                inside.append(number)
        return inside

    yield ratio_row(
        compare(
            f"metrics of one image, {len(mesh.elements)} elements",
            ("four masks, blobs, three metrics", four_masks),
            ("one circle mask by a loop", circle_mask),
            repeats=20,
        )
    )
