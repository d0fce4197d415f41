"""Accuracy as a function of the number of presses, for the user's own recording."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .figures import presses_figure as presses_figure
    from .report import press_outcome as press_outcome
    from .study import press_frontier as press_frontier
    from .trial import Trial as Trial, try_presses as try_presses

door(__name__, __file__)
