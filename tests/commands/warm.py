"""What commands that run in a fork find loaded already: modules, the shipped sensor's model and templates of its
head, tables of a database."""

import os
import signal
import sys
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.figure  # noqa: F401 - loaded here so that no fork has to

from cbsr_qa.app.run import run_sensor  # noqa: F401
from cbsr_qa.calibration.force import templates
from cbsr_qa.cli import ended
from cbsr_qa.config import load_sensor_type, load_station
from cbsr_qa.eit.estimate import load_model
from cbsr_qa.eit.inverse import imaging_problem
from cbsr_qa.store import open_store

_SENSOR_TYPE = load_sensor_type("disc-100mm").value
imaging_problem(_SENSOR_TYPE)
templates._everywhere(load_model(_SENSOR_TYPE), load_station("simulated").value.indenter)
with TemporaryDirectory() as _folder, open_store(f"sqlite:///{_folder}/runs.db"):
    pass


def run(folder: Path, arguments: list[str], environment: dict[str, str], out: Path, err: Path) -> None:
    """Run one command as the installed program does, its output in two files."""
    os.chdir(folder)
    os.environ.update(environment)
    sys.path[:0] = filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))
    with ExitStack() as stack:
        for stream, path in ((sys.stdout, out), (sys.stderr, err)):
            target = stack.enter_context(path.open("w"))
            stream.flush()
            os.dup2(target.fileno(), stream.fileno())
        code = ended(arguments)
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


def run_as_a_job(ignored: tuple[int, ...], *arguments: object) -> None:
    """Run one command in a process group of its own, as a shell does, with some signals ignored."""
    os.setpgid(0, 0)
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)
    run(*arguments)  # type: ignore[arg-type]
