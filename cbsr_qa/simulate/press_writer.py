"""What a head leaves in the sheet: strain ramps, in a press of its own from touching to lifting."""

from dataclasses import dataclass, replace
from typing import Protocol

from cbsr_qa.clock import in_ticks
from cbsr_qa.domain.scene import HeadPosition, SimulatedPress, StrainStep


class Sheet(Protocol):
    """What a head meets."""

    presses: list[SimulatedPress]

    def surface_mm(self, x_mm: float, y_mm: float, time_s: float) -> float:
        """How far the true surface lies below nominal."""
        ...

    def thickness_mm(self, x_mm: float, y_mm: float) -> float:
        """How thick it is."""
        ...

    def head_at(self, to: HeadPosition, before: HeadPosition, time_s: float, index: int) -> HeadPosition:
        """Where the head gets to from where it was, told to go somewhere; the index counts its movements."""
        ...


@dataclass(frozen=True, slots=True)
class _Stroke:
    """The last movement up or down, as it truly is."""

    start_s: float
    duration_s: float
    from_mm: float
    to_mm: float
    surface_mm: float


class PressWriter:
    """Follows where a head is indeed, and writes what lies below the true surface into the sheet's presses.

    Parameters
    ----------
    sheet : what the head meets; presses are appended to its list.
    at : where the head begins; depths are below the nominal surface, so that hovering is a negative depth.
    first_index : of its movements, the addresses of their random numbers.

    Ramps begin and end on ticks of the clock where movements do: see :mod:`cbsr_qa.clock`.
    """

    def __init__(self, sheet: Sheet, at: HeadPosition, *, first_index: int = 0) -> None:
        self._sheet = sheet
        self._true = at
        self._movements = first_index
        self._pressing: SimulatedPress | None = None
        self._stroke: _Stroke | None = None

    @property
    def true(self) -> HeadPosition:
        """Where the last movement gets the head to, or has got it to."""
        return self._true

    def count_from(self, index: int) -> None:
        """Address the movements that follow from here on."""
        self._movements = index

    def travel(self, to: HeadPosition, time_s: float) -> None:
        """Get to a place that the head was told to go to, at a time."""
        self._true = self._arrival(to, time_s)

    def stroke(self, to: HeadPosition, start_s: float, duration_s: float, speed_mm_s: float) -> None:
        """Begin to go up or down; the part of it below the true surface is written now."""
        x_mm, y_mm, true_mm = self._true
        surface = self._sheet.surface_mm(x_mm, y_mm, start_s)
        self._true = (x_mm, y_mm, self._arrival(to, start_s)[2])
        self._stroke = _Stroke(start_s, duration_s, true_mm, self._true[2], surface)
        before, after = max(true_mm - surface, 0.0), max(self._true[2] - surface, 0.0)
        if before != after:
            ramp_s = min(in_ticks(abs(after - before) / speed_mm_s), duration_s)
            begins = start_s if after < before else start_s + duration_s - ramp_s
            self._write(StrainStep(begins, ramp_s, (after - before) / self._sheet.thickness_mm(x_mm, y_mm)))
        if after == 0:
            self._pressing = None

    def halt(self, time_s: float) -> None:
        """Stop where the head is at a time: what was written of its last stroke for later does not happen."""
        stroke, self._stroke = self._stroke, None
        if stroke is None or time_s >= stroke.start_s + stroke.duration_s:
            return
        x_mm, y_mm, _ = self._true
        way = max(time_s - stroke.start_s, 0.0) / stroke.duration_s
        depth_mm = stroke.from_mm + way * (stroke.to_mm - stroke.from_mm)
        press = self._cut(time_s) if max(stroke.from_mm, stroke.to_mm) > stroke.surface_mm else None
        strain = press.strain_at(time_s) if press is not None else 0.0
        if strain > 0:
            depth_mm = stroke.surface_mm + strain * self._sheet.thickness_mm(x_mm, y_mm)
        self._pressing = press if strain > 0 else None
        self._true = (x_mm, y_mm, depth_mm)

    def _cut(self, time_s: float) -> SimulatedPress:
        """Replace the last press by one that ends now: whoever remembers the old one sees that it is another."""
        old = self._sheet.presses[-1]
        steps = [_until(step, time_s) for step in old.steps if step.start_s < time_s]
        new = SimulatedPress(old.index, old.x_mm, old.y_mm, steps)
        self._sheet.presses[-1] = new
        return new

    def _arrival(self, to: HeadPosition, time_s: float) -> HeadPosition:
        self._movements += 1
        return self._sheet.head_at(to, self._true, time_s, self._movements)

    def _write(self, step: StrainStep) -> None:
        if self._pressing is None:
            self._pressing = SimulatedPress(len(self._sheet.presses), *self._true[:2])
            self._sheet.presses.append(self._pressing)
        self._pressing.steps.append(step)


def _until(step: StrainStep, time_s: float) -> StrainStep:
    """Return the part of a ramp before a time."""
    if time_s >= step.start_s + step.ramp_s:
        return step
    part = (time_s - step.start_s) / step.ramp_s
    return replace(step, ramp_s=part * step.ramp_s, change=part * step.change)
