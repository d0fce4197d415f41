"""Effects on how frames are written down."""

from typing import Final

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure as Canvas

from cbsr_qa.report.draw.style import BLUE, QUIET, VERMILION
from simulation_figures import worlds
from simulation_figures.look import CLOSED, WITHOUT, Draw, by_electrode, key, note, panels, say
from simulation_figures.worlds import Array


def frame_loss() -> Canvas:
    """Which rows of which frames never arrive."""
    figure, (axes,) = panels(1)
    lost = worlds.world({"frame-loss": {"share": 0.2}}).transcript(_frames(60)).lost
    colours = ListedColormap(["#eef3f7", VERMILION])
    axes.imshow(lost.T, cmap=colours, interpolation="none", aspect="auto")
    say(axes, f"share = 0.2: {lost.any(axis=1).sum()} of 60 frames lack rows", "frame", "row (drive pair)", grid="")
    axes.set_yticks(range(0, 16, 5))
    return figure


def watchdog_dump() -> Canvas:
    """How late frames become, and one frame with a dump in it."""
    figure, (left, right) = panels(1.2, 1)
    often = {"time-skew": {}, "watchdog-dump": {"period_s": 5.0, "pause_ms": 75.0}}
    made = worlds.world(often)
    times = _frames(48)
    transcript = made.transcript(times)
    late_ms = 1e3 * transcript.pauses_s()
    left.step(times, late_ms[:, -1], where="mid", color=BLUE, label="last row of each frame")
    left.plot([0, 120], [0, 120 / (5 - 0.075) * 75], **CLOSED, label="75 ms every 5 s")
    left.axhline(0, **WITHOUT)
    say(left, "Each dump delays all that follows", "time [s]", "late [ms]")
    left.set_ylim(-80, 2600)
    key(left, "upper left")
    dump = next(one for one in transcript.dumps if 2 <= one.row <= 13)
    before = late_ms[dump.frame, 0] / 1e3
    pauses = transcript.pauses_s()[dump.frame] - before
    plain, delayed = (made.frame(0.0, 0, given).time_s for given in (np.zeros(16), pauses))
    assert plain is not None
    assert delayed is not None
    right.plot(range(15), 1e3 * np.diff(plain[:, 0]), "_", color=QUIET, markersize=8, label="without")
    right.plot(range(15), 1e3 * np.diff(delayed[:, 0]), "o", color=BLUE, markersize=3.5, label="with a dump")
    note(right, "75 ms", (dump.row - 1, 232), xytext=(6, 0), textcoords="offset points", va="center")
    say(right, "A frame with a dump", "", "to the next row [ms]")
    right.set_ylim(120, 290)
    by_electrode(right, "row (drive pair)")
    key(right, "upper left", ncols=2)
    return figure


def _frames(count: int) -> Array:
    """Middles of frames, one after the other [s]."""
    return 2.5 * (np.arange(count, dtype=np.float64) + 0.5)


FIGURES: Final[dict[str, Draw]] = {"frame-loss": frame_loss, "watchdog-dump": watchdog_dump}
