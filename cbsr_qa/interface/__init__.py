"""``import cbsr_qa as qa``: what notebooks and scripts may rely on, re-exported by :mod:`cbsr_qa`."""

from cbsr_qa.interface.analysing import Analysis as Analysis, analyse as analyse
from cbsr_qa.interface.comparing import compare as compare
from cbsr_qa.interface.database import Database as Database, open_database as open_database
from cbsr_qa.interface.images import Images as Images, image as image
from cbsr_qa.interface.result import Result as Result
from cbsr_qa.interface.running import run as run
from cbsr_qa.interface.scenes import Scene as Scene, simulate_scene as simulate_scene
from cbsr_qa.interface.stored_run import Run as Run
from cbsr_qa.interface.streaming import stream as stream
