"""Free space for what a run writes: frames and samples in the database, report and calibration file."""

import os
import shutil
from pathlib import Path
from typing import Final

from cbsr_qa.app.gate.request import Asked, Finding
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.setup import plan_of
from cbsr_qa.store.engine import parse_url, sqlite_file

_GB: Final = 1e9
#: Assumed time of a frame: how fast the instruments are is known only once they are open. The shipped
#: drivers take 0.24 s or more.
_FRAME_S: Final = 0.1
#: Bytes in the database of a reading (a voltage, its time and its flag), and those of a frame besides its readings.
_READING: Final = 17
_FRAME: Final = 1500
#: Bytes a second of the sampled channels: four of them, in blocks of their own at every frame.
_SAMPLES_PER_S: Final = 4 * 400 / _FRAME_S
#: Report, calibration file and its copy in the database.
_FILES: Final = 100e6
#: The write-ahead log may grow as large as what was written.
_TWICE: Final = 2


def enough_disk(asked: Asked) -> Finding:
    """Compare the free space where the run writes with what it needs."""
    stated_GB = asked.settings.disk_GB
    needed = estimate_run_bytes(asked) if stated_GB is None else stated_GB * _GB
    file = sqlite_file(parse_url(asked.request.database))
    folders = [*([] if file is None else [file.parent]), *asked.request.folders]
    on_disks = {
        _find_existing(folder).stat().st_dev: folder for folder in reversed(folders)
    }  # each is asked once: others write too
    least_free = min((shutil.disk_usage(_find_existing(folder)).free, str(folder)) for folder in on_disks.values())
    estimated_by = "the estimate for this run" if stated_GB is None else "disk_GB of the station"
    clause = f"{least_free[0] / _GB:.1f} GB free at {least_free[1]}, {needed / _GB:.1f} GB needed ({estimated_by})"
    if file is None:
        clause += "; the disk of the database server is not seen from here"
    if least_free[0] >= needed:
        return Finding(True, clause)
    return Finding(False, clause, "free some space, or use another folder or database", "CBSR_QA_VAR, --database")


def estimate_run_bytes(asked: Asked) -> float:
    """Estimate what a run writes, from its plan [bytes]."""
    dry = dry_run(plan_of(asked.configuration, asked.plugins), _FRAME_S)
    pattern = asked.configuration.sensor_type.pattern
    readings = len(pattern.drive) * len(pattern.measure)
    frames = dry.frames * (_READING * readings + _FRAME)
    return _TWICE * (frames + dry.duration_s * _SAMPLES_PER_S) + _FILES


def _find_existing(folder: Path) -> Path:
    """Return the folder, or the nearest above it that exists."""
    return next((one for one in (folder, *folder.absolute().parents) if os.path.lexists(one)), Path("/"))
