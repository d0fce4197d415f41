"""A batch's model as it is kept, of simulated maps."""

from dataclasses import asdict, replace
from functools import cache

import numpy as np
from batches import RADIUS_MM, draw_batch

from cbsr_qa.calibration.batch.model import learn_batch
from cbsr_qa.config.merging import BATCH_LAYOUT, digest_batch_model
from cbsr_qa.domain.plan.batch_model import KeptBatch, KeptKernel, KeptMember, KeptRelaxation, KeptSensor

#: Relaxation of the material cbsr-8wt after a press: of the conductance, and of the stress.
STRENGTH = KeptKernel(
    loading=True,
    weights=(-0.21, -0.54),
    time_constants_s=(2.2, 21.9),
    covariance=((1e-5, 0.0, 0.0, 0.0), (0.0, 1e-5, 0.0, 0.0), (0.0, 0.0, 1e-3, 0.0), (0.0, 0.0, 0.0, 1e-4)),
    scatter=(0.008, 0.02),
    scatter_freedom=13.0,
    loads=30,
    start_s=0.0,
)
STRESS = replace(STRENGTH, weights=(0.15, 0.1), time_constants_s=(2.0, 15.0), scatter=(4e-4, 2e-4))


@cache
def learn_sample(sensors=6, rho=0.9):
    return learn_batch(draw_batch(np.random.default_rng(5), rho, sensors=sensors)[0], radius_mm=RADIUS_MM)


def keep_sample(**changes):
    """A model of six sensors of batch 41, with its digest."""
    model = learn_sample()
    kept = KeptBatch(
        layout=BATCH_LAYOUT,
        digest="d" * 64,
        content_sha256="",
        batch="41",
        sensor_type="disc-100mm",
        material="cbsr-8wt",
        head_mm=13.0,
        radius_mm=RADIUS_MM,
        sensors=tuple(
            KeptSensor(
                f"S-{number}",
                f"01a22b00-0000-7000-8000-00000000000{number}",
                "",
                tuple(map(tuple, sensor.places_mm.tolist())),
                tuple(sensor.log_response.tolist()),
                tuple(sensor.variance.tolist()),
            )
            for number, sensor in enumerate(model.loads.sensors)
        ),
        members=tuple(
            KeptMember(**asdict(choice), weight=weight)
            for choice, weight in zip(model.choices, model.weights, strict=True)
        ),
        relaxation=KeptRelaxation(60.0, 55.0, STRENGTH, STRESS),
    )
    kept = replace(kept, **changes)
    return replace(kept, content_sha256=digest_batch_model(asdict(kept)))
