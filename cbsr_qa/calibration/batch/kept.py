"""What is kept of a batch's model, as the prior and the kernels that a further sensor is calibrated with."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import BatchLoads, SensorLoads
from cbsr_qa.calibration.batch.prior import BatchPrior
from cbsr_qa.domain.plan.batch_model import KeptBatch, KeptKernel, KeptMember, KeptSensor
from cbsr_qa.domain.results.relaxation import RelaxationKernel


def make_prior(kept: KeptBatch) -> BatchPrior:
    """Return the prior of a further sensor."""
    sensors = [make_loads(sensor) for sensor in kept.sensors]
    choices = [
        Hyperparameters(one.smooth, one.length_mm, one.scatter, one.own, one.common, one.level)
        for one in kept.members
    ]
    return BatchPrior(BatchLikelihood(BatchLoads(sensors)), choices, [member.weight for member in kept.members])


def keep_members(choices: Sequence[Hyperparameters], weights: Sequence[float]) -> tuple[KeptMember, ...]:
    """Return what is kept of the members of a prior."""
    return tuple(KeptMember(**asdict(choice), weight=weight) for choice, weight in zip(choices, weights, strict=True))


def keep_loads(serial: str, run: str, chain_head: str, loads: SensorLoads) -> KeptSensor:
    """Return what is kept of a sensor's loads."""
    return KeptSensor(
        serial=serial,
        run=run,
        chain_head=chain_head,
        places_mm=tuple((x, y) for x, y in loads.places_mm.tolist()),
        log_response=tuple(loads.log_response.tolist()),
        variance=tuple(loads.variance.tolist()),
        bend=None if loads.bend is None else tuple(loads.bend.tolist()),
        bend_stderr=loads.bend_stderr,
    )


def make_loads(kept: KeptSensor) -> SensorLoads:
    """Return the loads that were kept of a sensor."""
    return SensorLoads(
        np.array(kept.places_mm, dtype=np.float64).reshape(-1, 2),
        np.array(kept.log_response),
        np.array(kept.variance),
        None if kept.bend is None else np.array(kept.bend),
        kept.bend_stderr,
    )


def keep_kernel(kernel: RelaxationKernel) -> KeptKernel:
    """Return what is kept of a kernel that was learned."""
    return KeptKernel(
        loading=kernel.loading,
        weights=tuple(kernel.weights.tolist()),
        time_constants_s=tuple(kernel.time_constants_s.tolist()),
        covariance=tuple(map(tuple, kernel.covariance.tolist())),
        scatter=tuple(kernel.scatter.tolist()),
        scatter_freedom=float(kernel.scatter_freedom),
        loads=kernel.loads,
        start_s=float(kernel.start_s),
    )


def make_kernel(kept: KeptKernel) -> RelaxationKernel:
    """Return the kernel that was kept."""
    return RelaxationKernel(
        kept.loading,
        np.array(kept.weights),
        np.array(kept.time_constants_s),
        np.array(kept.covariance),
        np.array(kept.scatter),
        kept.scatter_freedom,
        kept.loads,
        kept.start_s,
    )
