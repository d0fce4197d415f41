"""Sensor type files: geometry, electrodes and pattern of a family of sensors.

Tables of sensor type files.
"""

import math
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field, PlainValidator, field_validator

from cbsr_qa.config.serials import check_serial_pattern
from cbsr_qa.config.tables import FileModel
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.domain.geometry.outlines import Disc, Polygon, SheetOutline, polygon_problems, rounding_problems
from cbsr_qa.domain.sensor.electrodes import (
    LEAST_ROOM,
    ElectrodeKind,
    ElectrodeLayout,
    Electrodes,
    PlacedElectrodes,
    placement_problems,
    widest_ring_mm,
    width_problem,
)
from cbsr_qa.domain.sensor.mesh import Mesh, mesh_of_arrays
from cbsr_qa.domain.sensor.patterns import DrivePattern, Pairs, imaging_problems, is_rule, list_pairs, pair_problems
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.plugin.problems import Problem, Table

Positive = Annotated[float, Field(gt=0)]
Name = Annotated[str, Field(min_length=1, max_length=64)]
#: Smallest and largest radius of a sheet, and farthest place [mm]: beyond, meshes fail by rounding.
SMALLEST_MM: Final = 1e-3
LARGEST_MM: Final = 1e6
Radius = Annotated[float, Field(ge=SMALLEST_MM, le=LARGEST_MM)]
Coordinate = Annotated[float, Field(ge=-LARGEST_MM, le=LARGEST_MM)]
Point = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]


def _mesh(value: object) -> Mesh:
    """Return the mesh from the content of its file, which the loader puts in place of the file's name."""
    if not isinstance(value, Mapping):
        raise ValueError("it must be the name of a mesh file")
    try:
        return mesh_of_arrays(value)
    except CbsrError as error:
        raise ValueError(error.reason) from error


class SensorTypeTable(Table):
    """``[sensor_type]``: a disc by its radius, any other sheet by its corners, or by a mesh with electrodes."""

    name: Name
    radius_mm: Radius | None = None
    outline_mm: Annotated[list[Point], Field(max_length=500)] | None = None
    corner_radius_mm: Annotated[float, Field(ge=0)] = 0.0
    mesh: Annotated[Any, PlainValidator(_mesh)] = None
    thickness_mm: Positive
    response: Literal["increase", "decrease", "auto"] = "auto"
    serial_pattern: Annotated[str, AfterValidator(check_serial_pattern)] | None = None
    unique_parts: list[Name] = Field(default_factory=list)


class ElectrodesTable(Table):
    """``[electrodes]``: a ring or a list of places; pins have a diameter, arcs a length along the edge."""

    kind: Literal["pin", "arc"]
    count: Annotated[int, Field(ge=3, le=256)] | None = None
    ring_radius_mm: Positive | None = None
    diameter_mm: Positive | None = None
    length_mm: Positive | None = None
    first_angle_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    direction: Literal["counterclockwise", "clockwise"] = "counterclockwise"
    positions_mm: Annotated[list[Point], Field(min_length=2, max_length=256)] | None = None

    @property
    def width_key(self) -> str:
        return "diameter_mm" if self.kind == "pin" else "length_mm"

    @property
    def width_mm(self) -> float | None:
        """A pin's diameter or an arc's length."""
        return self.diameter_mm if self.kind == "pin" else self.length_mm

    @property
    def number(self) -> int | None:
        return self.count if self.positions_mm is None else len(self.positions_mm)


def _rule_or_pairs(value: object) -> object:
    if isinstance(value, str):
        if not is_rule(value):
            raise ValueError("allowed: 'adjacent', 'opposite', 'skip-1', 'skip-2' and so on, or pairs [[0, 1], …]")
    elif not isinstance(value, list) or not all(
        isinstance(pair, list) and len(pair) == 2 and all(type(electrode) is int for electrode in pair)
        for pair in value
    ):
        raise ValueError("it must be the name of a rule or an array of pairs of electrodes, [[0, 1], …]")
    return value


RuleOrPairs = Annotated[str | list[list[int]], PlainValidator(_rule_or_pairs)]


class PatternTable(Table):
    """``[pattern]``: each the name of a rule, or the pairs themselves."""

    drive: RuleOrPairs = "adjacent"
    measure: RuleOrPairs = "adjacent"

    def pairs(self, kind: str, electrode_count: int) -> Pairs:
        """Return the drive or measure pairs; RefusedError where the rule does not suit the electrodes."""
        stated: str | list[list[int]] = getattr(self, kind)
        if isinstance(stated, str):
            return list_pairs(stated, electrode_count)
        return tuple((first, second) for first, second in stated)


_OUTLINE = ("sensor_type", "outline_mm")
_POSITIONS = ("electrodes", "positions_mm")
#: Keys that place a ring; a list of positions needs none of them.
_RING_KEYS = ("count", "ring_radius_mm", "first_angle_deg", "direction")
#: Keys that describe an outline; a mesh brings its own.
_OUTLINE_KEYS = ("radius_mm", "outline_mm", "corner_radius_mm")


class SensorTypeFile(FileModel[SensorType]):
    """A sensor type file."""

    sensor_type: SensorTypeTable
    electrodes: ElectrodesTable | None = None
    pattern: PatternTable = Field(default_factory=PatternTable)

    def problems(self) -> Iterator[Problem]:
        """The outline is one, electrodes fit it and do not touch, and the pattern is of these electrodes."""
        if self.sensor_type.mesh is not None:
            yield from self._mesh_problems()
        else:
            yield from self._outline_problems()
            if self.electrodes is None:
                yield Problem(("electrodes",), "is missing; only a mesh brings its own electrodes")
            else:
                yield from self._key_problems(self.electrodes)
                yield from self._width_problems(self.electrodes)
                yield from self._ring_problems(self.electrodes)
            yield from self._placement_problems()
        yield from self._pattern_problems()

    def _mesh_problems(self) -> Iterator[Problem]:
        for key in _OUTLINE_KEYS:
            if key in self.sensor_type.model_fields_set:
                yield Problem(("sensor_type", key), "does not apply where mesh is given")
        if self.electrodes is not None:
            yield Problem(("electrodes",), "does not apply where mesh is given: the mesh carries them")
        if self._count is None:
            yield Problem(("sensor_type", "mesh"), "carries fewer than 3 electrodes")

    def _outline_problems(self) -> Iterator[Problem]:
        sheet = self.sensor_type
        if sheet.outline_mm is None:
            if sheet.radius_mm is None:
                yield Problem(("sensor_type", "radius_mm"), "is missing; a sheet that is no disc needs outline_mm")
            if sheet.corner_radius_mm:
                yield Problem(("sensor_type", "corner_radius_mm"), "does not apply to a disc")
            return
        if sheet.radius_mm is not None:
            yield Problem(("sensor_type", "radius_mm"), "does not apply where outline_mm is given")
        corner_problems = list(polygon_problems(sheet.outline_mm))
        for corner, finding in corner_problems:
            yield Problem(_OUTLINE if corner is None else (*_OUTLINE, corner), finding)
        for finding in () if corner_problems else rounding_problems(sheet.outline_mm, sheet.corner_radius_mm):
            yield Problem(("sensor_type", "corner_radius_mm"), finding)
        if self._outline is not None and self._outline.radius_mm < SMALLEST_MM:
            finding = (
                f"has the area of a disc of {self._outline.radius_mm:g} mm; a sheet has at least {SMALLEST_MM:g} mm"
            )
            yield Problem(_OUTLINE, finding)

    def _key_problems(self, electrodes: ElectrodesTable) -> Iterator[Problem]:
        if electrodes.positions_mm is not None:
            for key in _RING_KEYS:
                if key in electrodes.model_fields_set:
                    yield Problem(("electrodes", key), "does not apply where positions_mm is given")
            return
        for key in ("count", "ring_radius_mm"):
            if getattr(electrodes, key) is None:
                yield Problem(("electrodes", key), "is missing; without a ring positions_mm is needed")

    def _width_problems(self, electrodes: ElectrodesTable) -> Iterator[Problem]:
        key = electrodes.width_key
        other_key = "length_mm" if key == "diameter_mm" else "diameter_mm"
        if getattr(electrodes, other_key) is not None:
            yield Problem(("electrodes", other_key), f"does not apply where kind is {electrodes.kind!r}; use {key}")
        if electrodes.width_mm is None:
            yield Problem(("electrodes", key), f"is missing; it is needed where kind is {electrodes.kind!r}")
            return
        if electrodes.positions_mm is not None or electrodes.count is None or electrodes.ring_radius_mm is None:
            return
        spacing_mm = 2 * math.pi * electrodes.ring_radius_mm / electrodes.count
        if electrodes.width_mm >= spacing_mm:
            finding = f"is {electrodes.width_mm:g}; it must be below the electrodes' spacing of {spacing_mm:.3g} mm"
            yield Problem(("electrodes", key), finding)

    def _ring_problems(self, electrodes: ElectrodesTable) -> Iterator[Problem]:
        """Rings on discs: inside the sheet (pins) or on its edge (arcs)."""
        radius_mm, ring_mm = self.sensor_type.radius_mm, electrodes.ring_radius_mm
        if ring_mm is None or radius_mm is None:
            return
        width_mm = electrodes.width_mm or 0.0
        highest_mm = widest_ring_mm(width_mm, radius_mm)
        if electrodes.kind == "pin" and ring_mm > highest_mm:
            finding = (
                f"is {ring_mm:g}; pins must lie inside the sheet, {LEAST_ROOM:.0%} of their diameter from its edge:"
                f" at most {highest_mm:g} mm here"
            )
            yield Problem(("electrodes", "ring_radius_mm"), finding)
        if electrodes.kind == "arc" and not math.isclose(ring_mm, radius_mm, rel_tol=1e-9):
            finding = f"is {ring_mm:g}; arcs lie on the sheet's edge: it must be {radius_mm:g}"
            yield Problem(("electrodes", "ring_radius_mm"), finding)

    def _placement_problems(self) -> Iterator[Problem]:
        outline, layout = self._outline, self._layout
        if outline is None or layout is None:
            return  # their problems are reported already
        assert self.electrodes is not None
        width_finding = width_problem(layout, outline.radius_mm)
        if width_finding is not None:
            yield Problem(("electrodes", self.electrodes.width_key), width_finding)
            return
        is_placed = isinstance(layout, PlacedElectrodes)
        for number, finding in placement_problems(layout, outline):
            if is_placed:
                yield Problem(
                    _POSITIONS if number is None else (*_POSITIONS, number), f"(electrode {number}) {finding}"
                )
            else:
                electrode_text = "" if number is None else f"does not fit: electrode {number} "
                yield Problem(("electrodes", "ring_radius_mm"), f"{electrode_text}{finding}")

    def _pattern_problems(self) -> Iterator[Problem]:
        count = self._count
        if count is None:
            return
        problems = [Problem(path, finding) for path, finding in self._pair_problems(count)]
        yield from problems
        if not problems and count > 2:  # two pins make a strip, which is not imaged
            pattern = DrivePattern(count, self.pattern.pairs("drive", count), self.pattern.pairs("measure", count))
            for finding in imaging_problems(pattern):
                yield Problem(("pattern",), finding)

    def _pair_problems(self, count: int) -> Iterator[tuple[tuple[str | int, ...], str]]:
        for kind in ("drive", "measure"):
            stated: str | list[list[int]] = getattr(self.pattern, kind)
            if isinstance(stated, str):
                try:
                    list_pairs(stated, count)
                except RefusedError as error:
                    yield ("pattern", kind), f"is {stated!r}; {error.reason}: {error.remedy}"
                continue
            for index, finding in pair_problems(stated, count):
                yield ("pattern", kind) if index is None else ("pattern", kind, index), finding

    @cached_property
    def _outline(self) -> SheetOutline | None:
        sheet = self.sensor_type
        if sheet.outline_mm is None:
            return None if sheet.radius_mm is None else Disc(sheet.radius_mm)
        try:
            return Polygon(tuple((x, y) for x, y in sheet.outline_mm), sheet.corner_radius_mm)
        except RefusedError:
            return None

    @property
    def _count(self) -> int | None:
        """Number of electrodes; None where the file does not state it, or a mesh has too few."""
        if self.sensor_type.mesh is not None:
            electrode_count = len(self.sensor_type.mesh.electrode_edges)
            return electrode_count if electrode_count >= 3 else None
        return None if self.electrodes is None else self.electrodes.number

    @cached_property
    def _layout(self) -> Electrodes | None:
        electrodes = self.electrodes
        if electrodes is None:
            return None
        kind, width_mm = ElectrodeKind(electrodes.kind), electrodes.width_mm
        if width_mm is None:
            return None
        if electrodes.positions_mm is not None:
            return PlacedElectrodes(kind, tuple((x, y) for x, y in electrodes.positions_mm), width_mm)
        if electrodes.count is None or electrodes.ring_radius_mm is None:
            return None
        try:
            return ElectrodeLayout(
                count=electrodes.count,
                kind=kind,
                ring_radius_mm=electrodes.ring_radius_mm,
                width_mm=width_mm,
                first_angle_deg=electrodes.first_angle_deg,
                counterclockwise=electrodes.direction == "counterclockwise",
            )
        except RefusedError:
            return None

    def to_domain(self) -> SensorType:
        sheet, count = self.sensor_type, self._count
        assert count is not None
        pattern = DrivePattern(count, *(self.pattern.pairs(kind, count) for kind in ("drive", "measure")))
        response = Response(sheet.response)
        if sheet.mesh is not None:
            from cbsr_qa.eit.mesh.files import mesh_sensor  # few sheets have a mesh of their own

            return mesh_sensor(sheet.name, sheet.mesh, pattern, thickness_mm=sheet.thickness_mm, response=response)
        outline, layout = self._outline, self._layout
        assert outline is not None
        assert layout is not None
        polygon = outline if isinstance(outline, Polygon) else None
        return SensorType(sheet.name, outline.radius_mm, sheet.thickness_mm, layout, pattern, response, polygon)


class ScannedTypeFile(SensorTypeFile):
    """A sensor type file for readings that bring their pattern: its own is neither needed nor looked at."""

    @field_validator("pattern", mode="before")
    @classmethod
    def _leave_out(cls, _: Any) -> dict[str, Any]:
        return {}

    def _pattern_problems(self) -> Iterator[Problem]:
        yield from ()
