"""What a reconstruction answers in a fresh process, with another number of threads and another hash seed."""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.interfaces import Reconstruction

Array = NDArray[np.float64]
Factory = Callable[[], Reconstruction]

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_POLITE = {"OPENBLAS_THREAD_TIMEOUT": "4"}  # idle threads sleep at once: others may need the core
_COMMAND = "import sys; from cbsr_qa.testing.elsewhere import answer; answer(sys.argv[1])"


def images_elsewhere(
    factories: Sequence[Factory], problem: ImagingProblem, changes: Array, *, threads: int
) -> list[Array]:
    """Prepare and image in one fresh process.

    Parameters
    ----------
    factories : classes or functions a module holds by name, or partials of such.
    changes : (n, m), as ``PreparedReconstruction.images`` takes them.
    threads : of the numerical libraries there.

    Returns
    -------
    One (n, e) float64 for each factory.

    Raises
    ------
    RefusedError
        If a factory cannot be found by name from another process, or that process fails; says what it said.
    """
    with tempfile.TemporaryDirectory() as folder:
        try:
            (Path(folder) / "asked").write_bytes(pickle.dumps((list(factories), problem, changes)))
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise RefusedError(
                f"another process cannot be asked: {error}",
                remedy="use a class or function that a module holds by name",
            ) from error
        environment = os.environ | dict.fromkeys(_THREADS, str(threads)) | _POLITE | {"PYTHONHASHSEED": str(threads)}
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        done = subprocess.run(
            [sys.executable, "-c", _COMMAND, folder], env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RefusedError(f"the other process failed: {done.stderr.strip()}")
        answered: list[Array] = pickle.loads((Path(folder) / "answered").read_bytes())
        return answered


def answer(folder: str) -> None:
    """Do what was asked in a folder; called in the other process."""
    factories, problem, changes = pickle.loads((Path(folder) / "asked").read_bytes())
    images = [factory().prepare(problem).images(changes) for factory in factories]
    (Path(folder) / "answered").write_bytes(pickle.dumps(images))
