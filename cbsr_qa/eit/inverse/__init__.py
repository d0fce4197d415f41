"""The linearised inverse problem and what reconstructions share: priors, one-step solutions, noise."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .dual import (
        dual_matrix as dual_matrix,
        dual_spectrum as dual_spectrum,
    )
    from .noise_figures import (
        NoiseFigureForm as NoiseFigureForm,
        central_signal as central_signal,
        evidence_of as evidence_of,
        hyperparameter_for as hyperparameter_for,
        noise_figure as noise_figure,
        target_radius_mm as target_radius_mm,
    )
    from .one_step import (
        RidgeCurves as RidgeCurves,
        ridge_reconstruction as ridge_reconstruction,
    )
    from .overlap import overlap_fractions as overlap_fractions
    from .pixels import pixel_imaging as pixel_imaging
    from .priors import (
        Prior as Prior,
        high_pass as high_pass,
        indenter_smoothness as indenter_smoothness,
        laplace as laplace,
        noser as noser,
    )
    from .problem import (
        NOMINAL_CONTACT_MM as NOMINAL_CONTACT_MM,
        even_model as even_model,
        image_jacobian as image_jacobian,
        imaging_problem as imaging_problem,
        nominal_model as nominal_model,
        target_signal as target_signal,
    )
    from .readings import FEWEST_FRAMES as FEWEST_FRAMES, ReadingFold as ReadingFold, reading_noise as reading_noise
    from .regularisation import Criterion as Criterion, Regularisation as Regularisation
    from .scaling import changes as changes, scale_doubts as scale_doubts, scale_of as scale_of
    from .temporal import (
        Correlation as Correlation,
        TemporalImages as TemporalImages,
        lasting_noise_figure as lasting_noise_figure,
        smooth as smooth,
    )
    from .truncation import Truncation as Truncation
    from .uncertainty import masking_effect as masking_effect

door(__name__, __file__)
