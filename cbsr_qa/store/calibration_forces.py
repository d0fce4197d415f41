"""What a calibration says of force as a row, and back: the map, merging and scatter, but no templates."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.force_model import NUMBERS, ForceModel
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.relaxation import RelaxationKernel
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.store.arrays import digest, packed, unpacked
from cbsr_qa.store.result_tables import ForceRow

Array = NDArray[np.float64]

#: Prepares a model's templates from sensor type, used readings, merging [1/V], reference [V] and head.
PrepareForce = Callable[[SensorType, NDArray[np.bool_], Array, Array, Indenter], ForceModel]


def force_values(model: ForceModel) -> dict[str, Any]:
    """Return the row of a model, its calibration left out."""
    merged, readings = model.merging.shape
    arrays = [packed(values + 0.0) for values in (model.merging, model.log_response, model.log_response_stderr)]
    return {
        "merged": merged,
        "readings": readings,
        "merging": arrays[0],
        "nodes": len(model.log_response),
        "log_response": arrays[1],
        "log_response_stderr": arrays[2],
        "force_sha256": digest(f"{merged}x{readings}|1/V|{len(model.log_response)}", arrays),
        "stress_low_kpa": model.stress_kPa[0],
        "stress_high_kpa": model.stress_kPa[1],
        **{name: getattr(model, name) for name in NUMBERS},
        "kernels": {
            name: _kernel_values(kernel)
            for name, kernel in (("loading", model.loading), ("unloading", model.unloading))
            if kernel is not None
        },
    }


def stored_force(
    session: Session,
    calibration: str,
    prepare: PrepareForce | None,
    sensor_type: SensorType,
    used: NDArray[np.bool_],
    reference: Array,
    head: Indenter,
) -> ForceModel | None:
    """Return the force model of a calibration, its templates prepared again; None where it has none.

    Raises
    ------
    StoreError
        If what was stored was changed, nobody prepares the templates, or they are not on the lattice of the map.
    """
    row = session.get(ForceRow, calibration)
    if row is None:
        return None
    check_force(row)
    if prepare is None:
        raise StoreError(f"calibration {calibration} holds a force model, whose templates nobody prepares")
    merging = unpacked(row.merging, (row.merged, row.readings))
    prepared = prepare(sensor_type, used, merging, reference, head)
    if len(prepared.templates) != row.nodes:
        raise StoreError(
            f"calibration {calibration} has a map of {row.nodes} places; this version prepares templates for"
            f" {len(prepared.templates)}"
        )
    return replace(
        prepared,
        merging=merging,
        log_response=unpacked(row.log_response, (row.nodes,)),
        log_response_stderr=unpacked(row.log_response_stderr, (row.nodes,)),
        stress_kPa=(row.stress_low_kpa, row.stress_high_kpa),
        loading=_kernel(row, "loading"),
        unloading=_kernel(row, "unloading"),
        **{name: getattr(row, name) for name in NUMBERS},
    )


def check_force(row: ForceRow) -> None:
    """Raise StoreError where the bytes of a force model do not fit their digest."""
    arrays = (row.merging, row.log_response, row.log_response_stderr)
    if digest(f"{row.merged}x{row.readings}|1/V|{row.nodes}", arrays) != row.force_sha256:
        raise StoreError(
            f"calibration {row.calibration}: its force model is not what was stored",
            remedy="restore the database from a copy",
        )


def _kernel_values(kernel: RelaxationKernel) -> dict[str, Any]:
    return {
        "weights": kernel.weights.tolist(),
        "time_constants_s": kernel.time_constants_s.tolist(),
        "covariance": kernel.covariance.tolist(),
        "scatter": kernel.scatter.tolist(),
        "scatter_freedom": float(kernel.scatter_freedom),
        "loads": int(kernel.loads),
        "start_s": float(kernel.start_s),
        "why": kernel.why,
    }


def _kernel(row: ForceRow, name: str) -> RelaxationKernel | None:
    held = row.kernels.get(name)
    if held is None:
        return None
    arrays = {key: np.array(held[key], dtype=np.float64) for key in ("weights", "time_constants_s", "scatter")}
    count = len(arrays["weights"])
    return RelaxationKernel(
        loading=name == "loading",
        covariance=np.array(held["covariance"], dtype=np.float64).reshape(2 * count, 2 * count),
        scatter_freedom=float(held["scatter_freedom"]),
        loads=int(held["loads"]),
        start_s=float(held["start_s"]),
        why=str(held["why"]),
        **arrays,
    )
