"""Events that overlap in time: which the image shows apart, which it merges, which it loses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.analysis.recording.imaged_events import with_fates
from cbsr_qa.app.analyse import outcome
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.results.findings import LoadEvent
from cbsr_qa.domain.sensor.mesh import Mesh

RADIUS_MM = 50.0
_AXIS = np.linspace(-50.0, 50.0, 51)


def _mesh() -> Mesh:
    nodes = np.stack(np.meshgrid(_AXIS, _AXIS), axis=-1).reshape(-1, 2)
    corner = (51 * np.arange(50)[:, None] + np.arange(50)).ravel()
    lower = np.column_stack([corner, corner + 1, corner + 52])
    upper = np.column_stack([corner, corner + 52, corner + 51])
    return Mesh(nodes, np.vstack([lower, upper]).astype(np.int64))


MESH = _mesh()


def _change(x_mm: float, y_mm: float, size: float = 1.0) -> np.ndarray:
    return size * np.exp(-((MESH.centroids_mm - [x_mm, y_mm]) ** 2).sum(axis=1) / 9.0**2)


def _event_at(x_mm: float, y_mm: float, start_s: float, end_s: float, *, size=1.0, values=None) -> LoadEvent:
    image = Image(MESH, _change(x_mm, y_mm, size) if values is None else values)
    sign = 1 if size > 0 else -1
    return LoadEvent(start_s, start_s + 1, end_s, x_mm / RADIUS_MM, y_mm / RADIUS_MM, 0.0, 16, sign, 20.0, image)


def _fates(*events: LoadEvent) -> list[str]:
    def together(numbers: Sequence[int]) -> np.ndarray:
        changes = {events[k].image.values.tobytes(): events[k].image.values for k in numbers}
        return sum(changes.values())

    return [event.fate for event in with_fates(events, RADIUS_MM, together)]


BOTH = _change(20, 10) + _change(-20, 10)
FATES = {
    "one after another": ((_event_at(20, 0, 0, 5), _event_at(-20, 0, 6, 9)), ["", ""]),
    "put on beside another": ((_event_at(20, 0, 0, 20), _event_at(-20, 0, 5, 12)), ["", "apart"]),
    "both negative": (
        (_event_at(20, 0, 0, 20, size=-0.6), _event_at(-20, 0, 0.5, 12, size=-1.0)),
        ["apart", "apart"],
    ),
    "too close for the image": ((_event_at(4, 0, 0, 20), _event_at(-4, 0, 0.5, 12)), ["merged", "merged"]),
    "at once, in one change": ([_event_at(x, 10, 0, 9, values=BOTH) for x in (20, -20)], ["apart", "apart"]),
    "under a quarter of the other": (
        (_event_at(25, 0, 0, 20), _event_at(-25, 0, 0.5, 12, size=0.2)),
        ["apart", "missed"],
    ),
}


@pytest.mark.parametrize(("events", "fates"), FATES.values(), ids=FATES)
def test_what_becomes_of_events_that_overlap_is_told(events, fates):
    assert _fates(*events) == fates


@pytest.mark.parametrize(("fate", "said"), [("", None), ("merged", "merged")])
def test_the_document_says_what_became_of_an_event(fate, said):
    assert outcome.Event.from_load_event(replace(_event_at(0, 0, 0, 1), fate=fate)).fate == said
