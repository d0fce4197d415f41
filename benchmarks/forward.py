"""Voltages of a sheet under a load: exact local update against factorising again."""

from collections.abc import Iterator

import numpy as np

from benchmarks.rows import Row, ratio_row
from benchmarks.timing import compare
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.forward.local import LocalUpdate
from cbsr_qa.forward.meshing import sheet_mesh
from cbsr_qa.forward.model import ForwardModel

TITLE = "Forward model"


def rows() -> Iterator[Row]:
    """One load, and nine at once, on the mesh of the simulated bench."""
    sensor = load_sensor_type("disc-100mm").value
    mesh = sheet_mesh(sensor, size_mm=2.5)
    count = len(mesh.elements)
    contacts = np.full(sensor.electrodes.count, 0.2)
    model = ForwardModel(mesh, sensor.pattern, np.ones(count), contacts)
    local = LocalUpdate(model)
    from cbsr_qa.domain.loads import NINE_LOCATIONS_MM

    for places in (NINE_LOCATIONS_MM[:1], NINE_LOCATIONS_MM):
        pressed = [np.flatnonzero(np.hypot(*(mesh.centroids_mm - place).T) <= 6.5) for place in np.array(places)]
        elements = np.concatenate(pressed)
        change = np.full(len(elements), 0.12)
        conductance = np.ones(count)
        conductance[elements] += 0.12
        local.voltages(elements, change)  # the first frame at a place prepares it
        yield ratio_row(
            compare(
                f"one frame, {len(places)} of nine places pressed, {count} elements",
                ("local update", lambda elements=elements, change=change: local.voltages(elements, change)),
                (
                    "factorising again",
                    lambda conductance=conductance: ForwardModel(
                        mesh, sensor.pattern, conductance, contacts
                    ).voltages(),
                ),
                repeats=20,
            )
        )
