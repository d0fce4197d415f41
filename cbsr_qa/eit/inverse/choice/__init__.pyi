from .criteria import (
    RidgeCurves as RidgeCurves,
    by_cross_validation as by_cross_validation,
    by_discrepancy as by_discrepancy,
    by_l_curve as by_l_curve,
)
from .noise_figures import (
    Evidence as Evidence,
    NoiseFigureForm as NoiseFigureForm,
    central_signal as central_signal,
    evidence_of as evidence_of,
    hyperparameter_for as hyperparameter_for,
    noise_figure as noise_figure,
    noise_figure_of as noise_figure_of,
    searched as searched,
    target_radius_mm as target_radius_mm,
)
from .regularisation import Criterion as Criterion, Regularisation as Regularisation
