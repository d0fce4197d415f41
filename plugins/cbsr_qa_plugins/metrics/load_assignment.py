"""Which loads were seen as loads: missed and merged ones, and regions where nothing pressed."""

from typing import Any, ClassVar

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa_plugins.metrics._shared import at_load, masks_of, refuse_unknown


class LoadAssignment:
    """``false_regions`` [1] of each load and mask; ``missed_loads`` and ``merged_loads`` [1] of the run.

    A false region is one more than the loads that were held. Of several loads held at once each has the region that
    is assigned to it, a head's diameter away at most; one without is merged where it shares another's, else missed.
    The run's figures are of the main mask. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"false_regions": "1", "missed_loads": "1", "merged_loads": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("load-assignment", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Count under each mask."""
        return tuple(
            at_load(
                load,
                "false_regions",
                float(max(view.regions - load.together, 0)),
                "1",
                qualifier=qualifier,
                how=f"{view.regions} regions, {load.together} held; this one {view.fate}",
            )
            for view, qualifier in masks_of(load, run)
        )

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Count over all loads; a run without a load has no count."""
        views = [load.mask(run.main_mask) for load in run.loads]
        fates = [view.fate for view in views if view is not None]
        how = f"of {len(fates)} loads, at the {100 * run.main_mask:g} % mask" if fates else "nothing was pressed"
        return tuple(
            Measurement(f"{fate}_loads", float(fates.count(fate)) if fates else None, "1", how=how)
            for fate in ("missed", "merged")
        )
