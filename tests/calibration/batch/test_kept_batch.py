"""What is kept of a batch's model makes the same prior and the same kernels again."""

import numpy as np
from kept_batches import STRENGTH, keep_sample, learn_sample

from cbsr_qa.calibration.batch.kept import keep_kernel, make_kernel, make_prior

TARGETS_MM = np.array([[0.0, 0.0], [20.0, 20.0], [-35.0, 5.0], [3.0, 4.0]])


def test_a_kept_model_is_the_same_prior():
    prior = learn_sample().prior
    for kept, learned in zip(make_prior(keep_sample()).predict(TARGETS_MM), prior.predict(TARGETS_MM), strict=True):
        np.testing.assert_allclose(kept, learned, rtol=1e-12)


def test_a_kept_kernel_is_the_same_kernel():
    assert keep_kernel(make_kernel(STRENGTH)) == STRENGTH
