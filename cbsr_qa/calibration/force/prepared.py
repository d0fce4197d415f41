"""A force model's templates, worked out again from what a calibration's record holds."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file import as_filed
from cbsr_qa.calibration.force.learning import unlearned_model
from cbsr_qa.calibration.force.templates import template_bank
from cbsr_qa.domain import CalibrationError, kept_fields
from cbsr_qa.domain.results import ForceModel
from cbsr_qa.domain.run import Indenter
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.eit.estimate import MergedReadings, load_model

Array = NDArray[np.float64]


def prepared_force(
    sensor_type: SensorType, used: NDArray[np.bool_], merging: Array, reference: Array, head: Indenter
) -> ForceModel:
    """Prepare the templates of a stored calibration; its map is left empty.

    Parameters
    ----------
    used : (drives, measures) bool with m True entries.
    merging : (r, m) [1/V] as in :class:`~cbsr_qa.domain.results.ForceModel`.
    reference : (drives, measures) [V], which gives the scale of the sensor against its model.

    Returns
    -------
    A model with lattice, node, templates, sizes and slopes; everything that is learned is zero.

    Raises
    ------
    CalibrationError
        If the merging is not of these readings, or the head fits nowhere.
    """
    groups, _ = sensor_type.pattern.reading_groups()
    _, first = np.unique(groups[used], return_index=True)
    if merging.shape != (len(first), int(used.sum())):
        raise CalibrationError(
            f"a merging of {merging.shape} does not make {len(first)} rows of {int(used.sum())} readings"
        )
    model = load_model(sensor_type)
    expected = model.unloaded()[used]
    scale = float(reference[used] @ expected / (expected @ expected))
    drive, measure = np.nonzero(used)
    weight = abs(scale) * np.abs(merging).sum(axis=1)
    readings = MergedReadings(used, merging * scale, drive[first], measure[first], weight)
    bank = template_bank(model, readings, head)
    return as_filed(unlearned_model(bank, merging))


def prepared_again(
    model: ForceModel, sensor_type: SensorType, used: NDArray[np.bool_], reference: Array, head: Indenter
) -> ForceModel:
    """Return a learned model with the templates that a database gives it: the same to the bit on one computer.

    Parameters and errors as of :func:`prepared_force`.
    """
    prepared = prepared_force(sensor_type, used, model.merging, reference, head)
    learned = {field.name: getattr(model, field.name) for field in kept_fields(ForceModel) if not field.kept.prepared}
    return replace(prepared, **learned)
