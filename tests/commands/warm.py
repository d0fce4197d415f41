"""What commands that run in a fork find done already: all that a run loads, compiles and works out once a process."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from one_press import one_press_recipe
from shared_statements import share_statements

from cbsr_qa.app.run.run import RunRequest, run_sensor
from cbsr_qa.calibration.force import templates
from cbsr_qa.cli.main import run_and_supervise  # noqa: F401
from cbsr_qa.config.loader import load_sensor_type, load_station
from cbsr_qa.eit.estimate.readings import load_model
from cbsr_qa.eit.inverse.problem import imaging_problem

_SENSOR_TYPE = load_sensor_type("disc-100mm").value
imaging_problem(_SENSOR_TYPE)
templates._press_everywhere(load_model(_SENSOR_TYPE), load_station("simulated").value.indenter)
share_statements()


def _run_once() -> None:
    """Run, analyse and report one press: a fork's own run then takes two thirds of the time."""
    with TemporaryDirectory() as folder, patch.dict(os.environ, CBSR_QA_VAR=f"{folder}/var"):
        recipe = Path(folder) / "one-press.toml"
        recipe.write_text(one_press_recipe("centre-of-mass-error", "noise-figure", "channel-noise", calibrate=True))
        run_sensor(RunRequest("simulated", str(recipe), "S-1"))


_run_once()
