"""Complete electrode model: solution, local updates, derivatives, closed forms."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .closed_forms import (
        FEWEST_RESISTORS as FEWEST_RESISTORS,
        ConcentricSheet as ConcentricSheet,
        arc_transfer_impedance as arc_transfer_impedance,
        lead_readings as lead_readings,
        project_to_ground as project_to_ground,
        ring_impedance as ring_impedance,
        ring_readings as ring_readings,
    )
    from .coverage import (
        Cover as Cover,
        NestedCover as NestedCover,
        cover as cover,
        cover_by_nested_outlines as cover_by_nested_outlines,
        disc_coverage as disc_coverage,
    )
    from .elements import FiniteElements as FiniteElements, reaches_mm as reaches_mm
    from .model import ForwardModel as ForwardModel, point_model as point_model
    from .value_range import (
        REFINED_ABOVE as REFINED_ABOVE,
        UNREFINED_ERROR as UNREFINED_ERROR,
        ValueRangeError as ValueRangeError,
        check_values as check_values,
        conducts as conducts,
    )

door(__name__, __file__)
