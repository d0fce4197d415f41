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
        prepared_force as prepared_force,
        template_bank as template_bank,
        unlearned_model as unlearned_model,
    )
    from .validity import (
        force_reductions as force_reductions,
        prediction_words as prediction_words,
        reading_reductions as reading_reductions,
        tried_beyond as tried_beyond,
        unmeasured as unmeasured,
    )

door(__name__, __file__)
