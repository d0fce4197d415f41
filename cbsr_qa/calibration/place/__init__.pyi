from .estimator import PlaceEstimator as PlaceEstimator, Places as Places
from .features import ceilings_of as ceilings_of, spikes_in as spikes_in
from .held_out import visits_of as visits_of
from .learning import FEWEST_PRESSES as FEWEST_PRESSES, PlaceLearned as PlaceLearned, learn_place as learn_place
from .mixture import mahalanobis as mahalanobis
