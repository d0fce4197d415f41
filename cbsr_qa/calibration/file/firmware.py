"""The part of a calibration that a microcontroller needs: small JSON, plain numbers, with the loss of accuracy.

Values keep the paths they have in the calibration file. Templates are on a coarser lattice and in 16 bits; merging is
a row and a weight for every reading, as every reading belongs to one row. Images, relaxations and the size dependence
of templates are left out: the firmware is for the calibrating head.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from cbsr_qa.calibration.file.content import Entry
from cbsr_qa.calibration.file.entries import encode
from cbsr_qa.calibration.file.json import dataset
from cbsr_qa.calibration.force.inverse import Flag, ForceInverse, map_tables
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.kept import list_fields
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import Calibration, ForceModel, Lattice

FORMAT: Final = "cbsr-qa calibration for firmware"
VERSION: Final = 1
FORMULA: Final = "docs/reference/calibration-file.md#force-step-by-step"
#: Steps of a template's values: 16 bits, signed.
_STEPS: Final = 32767
#: Largest relative error of a force that the choice of the lattice may add.
_WORST: Final = 0.02
_STRIDES: Final = (6, 5, 4, 3, 2)
_KEPT: Final = (
    "identity/",
    "sensor_type/name",
    "sensor_type/radius",
    "sensor_type/thickness",
    "sensor_type/electrodes/",
    "sensor_type/pattern/",
    "indenter/",
    "reference/voltages",
    "reference/current",
    "reconstruction/used",
    "quasi_static/against_stress/",
    "validity/",
    "force/",
)
_LEFT_OUT: Final = ("force/merging", "force/templates", "force/size_slope", "force/loading/", "force/unloading/")


@dataclass(frozen=True, slots=True)
class Loss:
    """Relative errors of forces by the coarser lattice, at places of the fine one within the calibrated radius.

    Parameters
    ----------
    places : number tried; ``places_lost`` of them lack coarse nodes around them.
    relative_force_error_rms, relative_force_error_worst : over the others, the place known.
    """

    places: int
    places_lost: int
    relative_force_error_rms: float
    relative_force_error_worst: float


def firmware_document(calibration: Calibration, *, stride: int | None = None) -> dict[str, Any]:
    """Return the content for firmware as one JSON document.

    CalibrationError without a force model, if a reading is merged into several rows, or the stride leaves no place.

    Parameters
    ----------
    stride : nodes of the calibration's lattice to one of the firmware's; by default the largest that reaches every
        calibrated place and adds at most 2 % to a force there.
    """
    if (np.count_nonzero(_model(calibration).merging, axis=0) != 1).any():
        raise CalibrationError("its merging gives a reading to several rows, which firmware does not expect")
    chosen_stride, thinned_model, loss = _choose_stride(calibration, stride)
    entry_by_path = encode(replace(calibration, force=thinned_model))
    firmware_entries = {
        path: entry_by_path[path]
        for path in sorted(entry_by_path)
        if path.startswith(_KEPT) and not path.startswith(_LEFT_OUT)
    }
    row = np.abs(thinned_model.merging).argmax(axis=0)
    firmware_entries["force/merging_row"] = Entry("index", row.astype(np.int64))
    firmware_entries["force/merging_weight"] = Entry("1/V", thinned_model.merging[row, np.arange(len(row))])
    datasets = {path: dataset(entry, spelt_out=2**31) for path, entry in sorted(firmware_entries.items())}
    datasets["force/templates"] = _quantise(thinned_model.templates)
    return {
        "format": FORMAT,
        "version": VERSION,
        "calibration": calibration.calibration,
        "digest": calibration.digest,
        "formula": FORMULA,
        "flags": {flag.name: flag.value for flag in Flag},
        "lattice_stride": chosen_stride,
        "loss": asdict(loss),
        "datasets": datasets,
    }


def thin_model(model: ForceModel, stride: int) -> ForceModel:
    """Return a model on every ``stride``-th node about the lattice's middle, with templates in 16 bits."""
    lattice = model.lattice
    first_node = [(count // 2) % stride for count in (lattice.columns, lattice.rows)]
    coarse_node = model.node[first_node[1] :: stride, first_node[0] :: stride]
    kept_nodes = coarse_node[coarse_node >= 0]
    quantised = np.round(model.templates[kept_nodes] * _STEPS) / _STEPS
    x_mm, y_mm = (
        origin_mm + k * lattice.spacing_mm for origin_mm, k in zip(lattice.origin_mm, first_node, strict=True)
    )
    of_nodes = (field.name for field in list_fields(ForceModel) if field.kept.dims.startswith("nodes"))
    return replace(
        model,
        lattice=Lattice((x_mm, y_mm), stride * lattice.spacing_mm, coarse_node.shape[1], coarse_node.shape[0]),
        node=np.where(coarse_node >= 0, np.cumsum(coarse_node >= 0).reshape(coarse_node.shape) - 1, -1),
        **{name: getattr(model, name)[kept_nodes] for name in of_nodes} | {"templates": quantised},
        loading=None,
        unloading=None,
    )


def measure_loss(calibration: Calibration, thin: ForceModel) -> Loss:
    """Return the loss of a coarser model of a calibration."""
    model = _model(calibration)
    fine = TemplateFilter(model)
    places = _find_calibrated_places(calibration, model, fine)
    line, area_mm2 = calibration.against_stress, calibration.indenter.area_mm2
    middle_kPa = max(sum(model.stress_kPa) / 2, 1.0)
    contrast = line.slope.value * middle_kPa + line.intercept.value
    rows = fine.template(places) * (2 * contrast / (2 + contrast))

    def force(of: ForceModel, matches: Matches) -> Array:
        return ForceInverse(of, line, area_mm2, map_tables(of)).force(matches)[0]

    true, coarse = force(model, fine.match_at(rows, places)), force(thin, TemplateFilter(thin).match_at(rows, places))
    finite_mask = np.isfinite(coarse)
    error = coarse[finite_mask] / true[finite_mask] - 1
    lost_count = int(np.count_nonzero(~finite_mask))
    if not finite_mask.any():
        return Loss(len(places), lost_count, 1.0, 1.0)
    return Loss(len(places), lost_count, float(np.sqrt(np.mean(error**2))), float(np.abs(error).max()))


def _model(calibration: Calibration) -> ForceModel:
    if calibration.force is None:
        raise CalibrationError(f"calibration {calibration.calibration} holds no force model: {calibration.no_force}")
    return calibration.force


def _choose_stride(calibration: Calibration, stride: int | None) -> tuple[int, ForceModel, Loss]:
    model = _model(calibration)
    for candidate in _STRIDES if stride is None else (stride,):
        if candidate < 1 or min(model.lattice.columns, model.lattice.rows) // candidate < 4:
            largest_stride = min(model.node.shape) // 4
            raise CalibrationError(f"a stride of {candidate} leaves no lattice; 1 to {largest_stride} are allowed")
        thinned_model = thin_model(model, candidate)
        if not (thinned_model.node >= 0).any():
            continue
        loss = measure_loss(calibration, thinned_model)
        if stride is not None or (loss.places_lost == 0 and loss.relative_force_error_worst <= _WORST):
            return candidate, thinned_model, loss
    if stride is not None:
        raise CalibrationError(f"a stride of {stride} leaves no place on the sheet")
    thinned_model = thin_model(model, 1)
    return 1, thinned_model, measure_loss(calibration, thinned_model)


def _find_calibrated_places(calibration: Calibration, model: ForceModel, fine: TemplateFilter) -> Array:
    lattice_mm = model.lattice.places_mm()
    node = model.node.ravel()
    fits = np.where(node >= 0, model.fits[node], False)
    near_mask = np.hypot(*lattice_mm.T) <= calibration.validity.radius_mm
    # Between nodes, where interpolation is worst.
    places = lattice_mm[fits & near_mask] + model.lattice.spacing_mm / 2
    reached_mm = places[np.isfinite(fine.template(places)).all(axis=1)]
    if not len(reached_mm):
        raise CalibrationError("no calibrated place lies on its lattice")
    return np.asarray(reached_mm, dtype=np.float64)


def _quantise(templates: Array) -> dict[str, Any]:
    quantised = np.round(templates * _STEPS).astype(np.int64)
    return {
        "units": "1",
        "kind": "i2",
        "shape": list(quantised.shape),
        "scale": 1 / _STEPS,
        "values": quantised.ravel().tolist(),
    }
