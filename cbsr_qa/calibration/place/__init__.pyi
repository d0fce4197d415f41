from .estimator import PlaceEstimator as PlaceEstimator
from .learning import learn_place as learn_place
