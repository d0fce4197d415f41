from .page import (
    alike_in as alike_in,
    notes_of as notes_of,
    station_canvas as station_canvas,
    table_of as table_of,
    write_page as write_page,
    write_png as write_png,
)
from .point import Accuracy as Accuracy, Clock as Clock, Point as Point
from .recommend import Wish as Wish
from .runs import station_seconds as station_seconds, the_bench as the_bench, worth_the_station as worth_the_station
from .setting import Setting as Setting
from .station import (
    EVEN as EVEN,
    PAPER as PAPER,
    Tried as Tried,
    shortened as shortened,
    tried_alone as tried_alone,
    tried_on_paper as tried_on_paper,
)
from .study import Files as Files, Frontier as Frontier, frontier as frontier
