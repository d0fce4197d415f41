"""The batch as prior of a run: how its map is learned, and the kernels that its short holds borrow."""

from functools import lru_cache

from cbsr_qa.analysis.run.compensation import BorrowedKernels
from cbsr_qa.calibration.batch.kept import make_kernel, make_prior
from cbsr_qa.calibration.batch.learning import BatchLearner
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.batch_model import KeptBatch


def choose_batch_prior(settings: AnalysisSettings) -> tuple[BatchLearner, BorrowedKernels | None]:
    """Return what learns a map by the batch and a sensor's loads, and the batch's kernels if it has any.

    ConfigError if the settings hold no model of a batch.
    """
    if settings.batch is None:
        raise ConfigError(
            'the recipe has prior = "batch", and there is no model of the batch beside it',
            remedy="learn one: cbsr-qa batch model --batch BATCH",
        )
    return _learn_from(settings.batch)


@lru_cache(maxsize=4)
def _learn_from(kept: KeptBatch) -> tuple[BatchLearner, BorrowedKernels | None]:
    relaxation = kept.relaxation
    if relaxation is None:
        return BatchLearner(make_prior(kept), kept.digest), None
    borrowed = BorrowedKernels(
        relaxation.hold_s,
        relaxation.steady_s,
        make_kernel(relaxation.strength),
        make_kernel(relaxation.stress),
        None if relaxation.unloading is None else make_kernel(relaxation.unloading),
    )
    return BatchLearner(make_prior(kept), kept.digest), borrowed
