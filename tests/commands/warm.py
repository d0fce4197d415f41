"""What commands that run in a fork find loaded already: modules, the shipped sensor's model and templates of its
head, tables of a database."""

from tempfile import TemporaryDirectory

import matplotlib.figure  # noqa: F401 - loaded here so that no fork has to
from shared_statements import share_statements

from cbsr_qa.app.run.run import run_sensor  # noqa: F401
from cbsr_qa.calibration.force import templates
from cbsr_qa.cli.main import run_and_supervise  # noqa: F401
from cbsr_qa.config.loader import load_sensor_type, load_station
from cbsr_qa.eit.estimate.readings import load_model
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.store.opening import open_store

_SENSOR_TYPE = load_sensor_type("disc-100mm").value
imaging_problem(_SENSOR_TYPE)
templates._press_everywhere(load_model(_SENSOR_TYPE), load_station("simulated").value.indenter)
share_statements()
with TemporaryDirectory() as _folder, open_store(f"sqlite:///{_folder}/runs.db"):
    pass
