"""Place learned from a run's own presses, and whether that pays: both estimates of the same presses, left out.

Places are learned as from labelled presses (:mod:`cbsr_qa.calibration.place`), from the loads that calibrate, where
the station pressed. The model of the sheet has learned nothing from them but the sheet's pose.
"""

from cbsr_qa.analysis.run.place_found import RunPlace
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.results.observation import RunObservation


def run_place(run: RunObservation) -> RunPlace:
    """Return what the loads that calibrate teach about place, if the recipe asks; it is cached with the run."""
    return run.derive(_run_place)


def _run_place(run: RunObservation) -> RunPlace:
    if not run.settings.learn_place:
        return RunPlace(None, "the recipe does not ask for it")
    from cbsr_qa.analysis.run.place_learning import learn_and_compare  # few recipes ask for it

    try:
        return learn_and_compare(run)
    except CbsrError as error:
        return RunPlace(None, error.reason)
