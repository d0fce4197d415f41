"""The device under test: sensor type, electrodes, drive pattern, mesh."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .electrodes import (
        LEAST_ROOM as LEAST_ROOM,
        ElectrodeKind as ElectrodeKind,
        ElectrodeLayout as ElectrodeLayout,
        Electrodes as Electrodes,
        PlacedElectrodes as PlacedElectrodes,
        placement_problems as placement_problems,
        widest_ring_mm as widest_ring_mm,
        width_problem as width_problem,
    )
    from .mesh import (
        FARTHEST_MM as FARTHEST_MM,
        INTEGERS as INTEGERS,
        NAMES as NAMES,
        CircleArcs as CircleArcs,
        Mesh as Mesh,
        edge_lists as edge_lists,
        mesh_arrays as mesh_arrays,
        mesh_of_arrays as mesh_of_arrays,
    )
    from .patterns import (
        FEWEST_INDEPENDENT as FEWEST_INDEPENDENT,
        DrivePattern as DrivePattern,
        Pair as Pair,
        Pairs as Pairs,
        adjacent_pattern as adjacent_pattern,
        imaging_problems as imaging_problems,
        is_rule as is_rule,
        named_pairs as named_pairs,
        pair_problems as pair_problems,
    )
    from .sensor_type import (
        GivenMesh as GivenMesh,
        Material as Material,
        MeasuredKernel as MeasuredKernel,
        Parameter as Parameter,
        QuasiStatic as QuasiStatic,
        Relaxation as Relaxation,
        Response as Response,
        SensorIdentity as SensorIdentity,
        SensorType as SensorType,
        StripRelaxation as StripRelaxation,
        polygon_sensor as polygon_sensor,
    )

door(__name__, __file__)
