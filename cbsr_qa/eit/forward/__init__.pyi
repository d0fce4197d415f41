from .bodies import DeepTank as DeepTank, StripModel as StripModel, check_strip as check_strip
from .closed_forms import (
    FEWEST_RESISTORS as FEWEST_RESISTORS,
    ConcentricSheet as ConcentricSheet,
    arc_transfer_impedance as arc_transfer_impedance,
    grounded as grounded,
    lead_readings as lead_readings,
    pin_transfer_impedance as pin_transfer_impedance,
    point_transfer_impedance as point_transfer_impedance,
    ring_impedance as ring_impedance,
    ring_readings as ring_readings,
)
from .coverage import (
    WHOLE as WHOLE,
    Cover as Cover,
    cover as cover,
    disc_coverage as disc_coverage,
    elements_near as elements_near,
    outline_normals as outline_normals,
    shares as shares,
    slopes as slopes,
)
from .elements import FiniteElements as FiniteElements
from .inverse import InverseEntries as InverseEntries
from .local import LocalUpdate as LocalUpdate
from .model import ForwardModel as ForwardModel, point_model as point_model
from .value_range import (
    REFINED_ABOVE as REFINED_ABOVE,
    SCATTERED_ERROR as SCATTERED_ERROR,
    UNREFINED_ERROR as UNREFINED_ERROR,
    ValueRangeError as ValueRangeError,
    conducts as conducts,
)
