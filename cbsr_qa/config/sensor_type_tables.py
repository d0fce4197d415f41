"""Tables of sensor type files."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import Field, PlainValidator

from cbsr_qa.config.tables import Table
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.mesh_arrays import mesh_of_arrays
from cbsr_qa.domain.patterns import Pairs, is_rule, named_pairs

Positive = Annotated[float, Field(gt=0)]
Name = Annotated[str, Field(min_length=1, max_length=64)]
#: Smallest and largest radius of a sheet, and farthest place [mm]: beyond, meshes fail by rounding.
SMALLEST_MM: Final = 1e-3
LARGEST_MM: Final = 1e6
Radius = Annotated[float, Field(ge=SMALLEST_MM, le=LARGEST_MM)]
Coordinate = Annotated[float, Field(ge=-LARGEST_MM, le=LARGEST_MM)]
Point = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]


def _mesh(value: object) -> Mesh:
    """The content of a mesh file, which the loader puts in place of its name."""
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
        """The key that gives the electrodes' size."""
        return "diameter_mm" if self.kind == "pin" else "length_mm"

    @property
    def width_mm(self) -> float | None:
        """A pin's diameter or an arc's length."""
        return self.diameter_mm if self.kind == "pin" else self.length_mm

    @property
    def number(self) -> int | None:
        """How many electrodes there are; None where the file does not say."""
        return self.count if self.positions_mm is None else len(self.positions_mm)


def _rule_or_pairs(value: object) -> object:
    if isinstance(value, str):
        if not is_rule(value):
            raise ValueError("allowed: 'adjacent', 'opposite', 'skip-1', 'skip-2' and so on, or pairs [[0, 1], …]")
    elif not isinstance(value, list) or not all(_is_pair(pair) for pair in value):
        raise ValueError("it must be the name of a rule or an array of pairs of electrodes, [[0, 1], …]")
    return value


def _is_pair(pair: object) -> bool:
    return isinstance(pair, list) and len(pair) == 2 and all(type(electrode) is int for electrode in pair)


RuleOrPairs = Annotated[str | list[list[int]], PlainValidator(_rule_or_pairs)]


class PatternTable(Table):
    """``[pattern]``: each the name of a rule, or the pairs themselves."""

    drive: RuleOrPairs = "adjacent"
    measure: RuleOrPairs = "adjacent"

    def pairs(self, kind: str, electrode_count: int) -> Pairs:
        """Drive or measure pairs; RefusedError where the rule does not suit the electrodes."""
        given: str | list[list[int]] = getattr(self, kind)
        if isinstance(given, str):
            return named_pairs(given, electrode_count)
        return tuple((first, second) for first, second in given)
