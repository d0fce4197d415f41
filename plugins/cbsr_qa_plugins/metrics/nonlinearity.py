"""How far the sensed change leaves a straight line against stress."""

from typing import Any, ClassVar

import numpy as np

from cbsr_qa.calibrate.characteristic import (
    Characteristic,
    characteristics,
    data_sheet_loads,
    mean_characteristic,
    repeatability,
    why_no_force,
)
from cbsr_qa.calibrate.data_sheet import FEWEST_POINTS, Estimate, best_straight_line, terminal_line
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._run_figure import counted, percent, refused
from cbsr_qa_plugins.metrics._shared import refuse_unknown

_LINES = (("", "best straight line", best_straight_line), ("terminal-based", "line between the ends", terminal_line))


class Nonlinearity:
    """``nonlinearity`` [% of span]: largest deviation of the change against stress from a straight line.

    From the best straight line (independent linearity, ISA-51.1 and IEC 61298-2), and with the qualifier
    ``terminal-based`` from the line between the lowest and the highest strain. Of the mean over the locations that
    were pressed at the most strains, and of each of them. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"nonlinearity": "%"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("nonlinearity", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Draw the lines of the mean and of each location."""
        loads = data_sheet_loads(run)
        curves = characteristics(loads, run.main_mask)
        try:
            scatter: float | None = repeatability(loads, run.main_mask).value
        except NumericsError:
            scatter = None
        try:
            mean = mean_characteristic(curves)
            if mean.stress_kPa is None:
                raise NumericsError(f"no stress to draw the change against: {why_no_force(loads)}")
            found = [_of(mean, scatter, line) for line in range(len(_LINES))]
        except NumericsError as error:
            return (refused("nonlinearity", "%", error),)
        each = [c for c in curves if len(c.strain) >= FEWEST_POINTS and c.stress_kPa is not None and c.span > 0]
        return (*found, *(_of(curve, scatter, 0) for curve in each))


def _of(curve: Characteristic, scatter: float | None, line: int) -> Measurement:
    assert curve.stress_kPa is not None
    qualifier, words, draw = _LINES[line]
    errors = None if scatter is None else (scatter / np.sqrt(curve.loads)).tolist()
    drawn = draw(curve.stress_kPa.tolist(), (curve.change / curve.span).tolist(), errors)
    presses = counted(int(curve.loads.sum()), "press", "presses")
    how = (
        f"from the {words} through {len(curve.strain)} strains from {100 * curve.strain[0]:g} to"
        f" {100 * curve.strain[-1]:g} %, of the change at the highest; {presses}"
    )
    location = "" if curve.location == "mean" else curve.location
    return percent(
        "nonlinearity", Estimate(drawn.largest, drawn.stderr, 0), how, qualifier=qualifier, location=location
    )
