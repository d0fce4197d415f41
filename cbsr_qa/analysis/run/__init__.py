"""Analysis of a stored run: reference, loads, relaxations, force."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .agreement import (
        DirectedAgreement as DirectedAgreement,
        image_against_blobs as image_against_blobs,
        sheet_against_strip as sheet_against_strip,
    )
    from .estimates import (
        EstimatedLoad as EstimatedLoad,
        estimated_loads as estimated_loads,
        model_scale as model_scale,
    )
    from .fewer_places import MapCost as MapCost, farthest_first as farthest_first, map_costs as map_costs
    from .force import (
        HELD_OUT as HELD_OUT,
        TRIAL_LEFT_OUT as TRIAL_LEFT_OUT,
        ForceTest as ForceTest,
        RunForce as RunForce,
        begin_force as begin_force,
        force_tests as force_tests,
        hold_traces as hold_traces,
        learned_from as learned_from,
        run_force as run_force,
    )
    from .force_quality import (
        ForceErrors as ForceErrors,
        calibrated_radius_mm as calibrated_radius_mm,
        detectable_forces as detectable_forces,
        errors_of as errors_of,
        gauge_factor as gauge_factor,
        global_errors as global_errors,
        map_quality as map_quality,
        places_mm as places_mm,
        tests_of as tests_of,
    )
    from .live import LivePreview as LivePreview, PlacePreview as PlacePreview
    from .loads import load_window as load_window
    from .observe import observe_run as observe_run
    from .place import PlaceErrors as PlaceErrors, run_place as run_place
    from .reference import check_weighing as check_weighing, unloaded_frames as unloaded_frames
    from .sizes import (
        FLAT as FLAT,
        SizeResponse as SizeResponse,
        size_response as size_response,
        size_response_of as size_response_of,
    )

door(__name__, __file__)
