"""Places of presses on a sheet, learned from presses at known places. In use it needs numpy alone."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .estimator import PlaceEstimator as PlaceEstimator
    from .faulty import MOST_FAULTY as MOST_FAULTY, FaultyGroups as FaultyGroups
    from .features import (
        SPIKY as SPIKY,
        ring_axes as ring_axes,
        safe_ceilings as safe_ceilings,
        spikes_among as spikes_among,
    )
    from .held_out import evenly as evenly, mean_by_place as mean_by_place, visits_of as visits_of
    from .learning import FEWEST_PRESSES as FEWEST_PRESSES, PlaceLearned as PlaceLearned, learn_place as learn_place
    from .mixture import mahalanobis as mahalanobis
    from .modelled import (
        ModelledEstimator as ModelledEstimator,
        log_likelihood as log_likelihood,
        log_likelihood_slopes as log_likelihood_slopes,
        most_alike as most_alike,
        unit_rows as unit_rows,
        with_variance as with_variance,
    )
    from .places import Places as Places
    from .quantity import (
        Quantities as Quantities,
        QuantityEstimator as QuantityEstimator,
        learn_quantity as learn_quantity,
    )

door(__name__, __file__)
