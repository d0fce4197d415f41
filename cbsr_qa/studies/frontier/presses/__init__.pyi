from .figures import presses_figure as presses_figure
from .report import press_outcome as press_outcome
from .study import press_frontier as press_frontier
from .trial import Trial as Trial, try_presses as try_presses
