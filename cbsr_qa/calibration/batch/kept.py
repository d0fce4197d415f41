"""What is kept of a batch's model, as the prior and the kernels that a further sensor is calibrated with."""

import numpy as np

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import BatchLoads, SensorLoads
from cbsr_qa.calibration.batch.prior import BatchPrior
from cbsr_qa.domain.plan.batch_model import KeptBatch, KeptKernel
from cbsr_qa.domain.results.relaxation import RelaxationKernel


def make_prior(kept: KeptBatch) -> BatchPrior:
    """Return the prior of a further sensor."""
    sensors = [
        SensorLoads(
            np.array(sensor.places_mm, dtype=np.float64).reshape(-1, 2),
            np.array(sensor.log_response),
            np.array(sensor.variance),
            None if sensor.bend is None else np.array(sensor.bend),
            sensor.bend_stderr,
        )
        for sensor in kept.sensors
    ]
    choices = [
        Hyperparameters(one.smooth, one.length_mm, one.scatter, one.own, one.common, one.level)
        for one in kept.members
    ]
    return BatchPrior(BatchLikelihood(BatchLoads(sensors)), choices, [member.weight for member in kept.members])


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
