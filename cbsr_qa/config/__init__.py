"""Station, recipe, sensor type, material and scene files: TOML to pydantic to domain."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from . import text as text
    from .documents import (
        DocumentKind as DocumentKind,
        not_finite as not_finite,
        open_document as open_document,
        shipped_names as shipped_names,
    )
    from .limits import limits_digest as limits_digest
    from .loader import (
        Loaded as Loaded,
        load_material as load_material,
        load_pressed_type as load_pressed_type,
        load_recipe as load_recipe,
        load_scene as load_scene,
        load_scene_plan as load_scene_plan,
        load_sensor_type as load_sensor_type,
        load_station as load_station,
    )
    from .material import material_text as material_text
    from .merging import (
        Configuration as Configuration,
        FileContent as FileContent,
        canonical_json as canonical_json,
        configured_files as configured_files,
        merge as merge,
        restore as restore,
    )
    from .paths import (
        calibrations_folder as calibrations_folder,
        check_folder as check_folder,
        database_url as database_url,
        materials_folder as materials_folder,
        reports_folder as reports_folder,
        scenes_folder as scenes_folder,
        var_folder as var_folder,
        writable_folder as writable_folder,
    )
    from .recipe import PICTURES as PICTURES
    from .scene_checks import check_plan as check_plan, edge_remarks as edge_remarks
    from .serials import (
        fits_pattern as fits_pattern,
        validate_batch as validate_batch,
        validate_operator as validate_operator,
        validate_reason as validate_reason,
        validate_serial as validate_serial,
    )
    from .tables import (
        FileModel as FileModel,
        validated as validated,
    )
    from .text import (
        line_of as line_of,
        toml_document as toml_document,
    )

door(__name__, __file__)
