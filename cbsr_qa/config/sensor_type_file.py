"""Sensor type files: geometry, electrodes and pattern of a family of sensors."""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from cbsr_qa.config.tables import FileModel, Problem, Table
from cbsr_qa.domain.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.patterns import adjacent_pattern
from cbsr_qa.domain.sensor import Response, SensorType

Positive = Annotated[float, Field(gt=0)]
Name = Annotated[str, Field(min_length=1, max_length=64)]


class SensorTypeTable(Table):
    """``[sensor_type]``."""

    name: Name
    radius_mm: Positive
    thickness_mm: Positive
    response: Literal["increase", "decrease", "auto"] = "auto"


class ElectrodesTable(Table):
    """``[electrodes]``: pins have a diameter, arcs a length along the edge."""

    count: Annotated[int, Field(ge=3, le=256)]
    kind: Literal["pin", "arc"]
    ring_radius_mm: Positive
    diameter_mm: Positive | None = None
    length_mm: Positive | None = None
    first_angle_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    direction: Literal["counterclockwise", "clockwise"] = "counterclockwise"

    @property
    def width_key(self) -> str:
        """The key that gives the electrodes' size."""
        return "diameter_mm" if self.kind == "pin" else "length_mm"

    @property
    def width_mm(self) -> float | None:
        """A pin's diameter or an arc's length."""
        return self.diameter_mm if self.kind == "pin" else self.length_mm


class PatternTable(Table):
    """``[pattern]``."""

    drive: Literal["adjacent"] = "adjacent"
    measure: Literal["adjacent"] = "adjacent"


class SensorTypeFile(FileModel[SensorType]):
    """A sensor type file."""

    sensor_type: SensorTypeTable
    electrodes: ElectrodesTable
    pattern: PatternTable = Field(default_factory=PatternTable)

    def problems(self) -> Iterator[Problem]:
        """The ring lies inside the sheet (pins) or on its edge (arcs), and neighbours do not touch."""
        electrodes, radius_mm = self.electrodes, self.sensor_type.radius_mm
        yield from self._width_problems()
        ring_mm, width_mm = electrodes.ring_radius_mm, electrodes.width_mm or 0.0
        if electrodes.kind == "pin" and ring_mm + width_mm / 2 >= radius_mm:
            highest = radius_mm - width_mm / 2
            what = f"is {ring_mm:g}; pins must lie inside the sheet: below {highest:g} mm here"
            yield Problem(("electrodes", "ring_radius_mm"), what)
        if electrodes.kind == "arc" and not math.isclose(ring_mm, radius_mm, rel_tol=1e-9):
            what = f"is {ring_mm:g}; arcs lie on the sheet's edge: it must be {radius_mm:g}"
            yield Problem(("electrodes", "ring_radius_mm"), what)

    def _width_problems(self) -> Iterator[Problem]:
        electrodes, key = self.electrodes, self.electrodes.width_key
        other = "length_mm" if key == "diameter_mm" else "diameter_mm"
        if getattr(electrodes, other) is not None:
            yield Problem(("electrodes", other), f"does not apply where kind is {electrodes.kind!r}; use {key}")
        if electrodes.width_mm is None:
            yield Problem(("electrodes", key), f"is missing; it is needed where kind is {electrodes.kind!r}")
            return
        spacing_mm = 2 * math.pi * electrodes.ring_radius_mm / electrodes.count
        if electrodes.width_mm >= spacing_mm:
            what = f"is {electrodes.width_mm:g}; it must be below the electrodes' spacing of {spacing_mm:.3g} mm"
            yield Problem(("electrodes", key), what)

    def to_domain(self) -> SensorType:
        """Return the sensor type."""
        electrodes = self.electrodes
        assert electrodes.width_mm is not None
        return SensorType(
            name=self.sensor_type.name,
            radius_mm=self.sensor_type.radius_mm,
            thickness_mm=self.sensor_type.thickness_mm,
            electrodes=ElectrodeLayout(
                count=electrodes.count,
                kind=ElectrodeKind(electrodes.kind),
                ring_radius_mm=electrodes.ring_radius_mm,
                width_mm=electrodes.width_mm,
                first_angle_deg=electrodes.first_angle_deg,
                counterclockwise=electrodes.direction == "counterclockwise",
            ),
            pattern=adjacent_pattern(electrodes.count),
            response=Response(self.sensor_type.response),
        )
