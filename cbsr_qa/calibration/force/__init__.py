"""How a sensor's readings become newtons: learning, templates, validity."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .learning import (
        CalibrationLoads as CalibrationLoads,
        LearnedForce as LearnedForce,
        learn_force as learn_force,
    )
    from .pressure import PressureMap as PressureMap
    from .templates import (
        CONTRAST as CONTRAST,
        RESIDUE_SHARE as RESIDUE_SHARE,
        TemplateBank as TemplateBank,
        begin_templates as begin_templates,
        make_even_model as make_even_model,
        prepare_force as prepare_force,
        template_bank as template_bank,
    )
    from .validity import (
        force_reductions as force_reductions,
        list_missing_forces as list_missing_forces,
        list_untrained_ranges as list_untrained_ranges,
        prediction_words as prediction_words,
        reading_reductions as reading_reductions,
    )

door(__name__, __file__)
