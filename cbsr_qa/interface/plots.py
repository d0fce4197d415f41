"""Drawings on axes of matplotlib."""

from typing import TYPE_CHECKING

from cbsr_qa.app.export.frames import join_channels
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.observation import Trace
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.report.draw.time import Span, draw_timeline

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: More presses than this are not named.
_MAX_NAMED = 24


def make_axes() -> "Axes":
    """Return axes of a new figure."""
    from matplotlib import pyplot

    _, axes = pyplot.subplots(layout="constrained")
    return axes


def plot_run(record: RunRecord, axes: "Axes | None") -> "Axes":
    """Draw the force of a run against time, its holds shaded. RefusedError if it holds no force."""
    forces = [block for block in join_channels(record.phases) if block.channel == "force"]
    if not forces:
        raise RefusedError(f"run {record.identity.run} holds no force", remedy="plot its frames: run.frames()")
    traces = [Trace("force", f.unit, f.time_s / 60, f.values) for f in forces]
    loads = [load for phase in record.phases for load in (*phase.loads, *phase.loops)]
    named = len(loads) <= _MAX_NAMED
    spans = [
        Span(load.hold_start_s / 60, load.release_start_s / 60, load.load.label if named else "") for load in loads
    ]
    axes = make_axes() if axes is None else axes
    draw_timeline(axes, traces, spans, time_label="time [min]")
    return axes
