"""Testing one sensor: run, resume, outputs, report rendered again."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .decided_again import (
        check_decided as check_decided,
        check_listed as check_listed,
        judging_recipe as judging_recipe,
    )
    from .material_output import material_of as material_of, why_no_material as why_no_material
    from .outcome import RunOutcome as RunOutcome, run_outcome as run_outcome
    from .outputs import report_sections as report_sections
    from .planned import PlannedRun as PlannedRun, plan_outcome as plan_outcome
    from .preflight import (
        check_cycles as check_cycles,
        check_recipe as check_recipe,
        check_unloaded as check_unloaded,
    )
    from .render import (
        Rendered as Rendered,
        outcome_of_stored as outcome_of_stored,
        render_stored as render_stored,
        rendered_outcome as rendered_outcome,
        with_versions as with_versions,
    )
    from .resume import known_next as known_next, resume_run as resume_run
    from .run import (
        RunRequest as RunRequest,
        default_seed as default_seed,
        plan_run as plan_run,
        preview_gate as preview_gate,
        run_sensor as run_sensor,
    )
    from .session import Session as Session
    from .stopping import stoppable as stoppable

door(__name__, __file__)
