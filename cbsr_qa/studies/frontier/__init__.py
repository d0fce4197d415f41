"""What accuracy costs in time."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .figures import station_svg as station_svg, write_png as write_png
    from .files import Files as Files
    from .point import Accuracy as Accuracy, Point as Point, TimeBasis as TimeBasis, stored as stored
    from .recommend import Recommendation as Recommendation, Target as Target
    from .report import frontier_outcome as frontier_outcome, table_of as table_of
    from .sensors import station_seconds as station_seconds
    from .setting import Setting as Setting
    from .station import (
        EVEN as EVEN,
        PAPER as PAPER,
        Tried as Tried,
        try_ways as try_ways,
        worth_the_station as worth_the_station,
    )
    from .study import Frontier as Frontier, frontier as frontier

door(__name__, __file__)
