from .estimator import PlaceEstimator as PlaceEstimator, Places as Places
from .learning import PlaceLearned as PlaceLearned, learn_place as learn_place
