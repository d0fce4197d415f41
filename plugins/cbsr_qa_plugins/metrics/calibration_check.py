"""Whether a sensor still does what its stored calibration says."""

from pathlib import Path
from typing import Any, ClassVar

from cbsr_qa.analysis.recheck import Recheck, recheck
from cbsr_qa.calibrate.file import read_contained
from cbsr_qa.calibrate.runtime import Calibration
from cbsr_qa.config.paths import calibrations_folder
from cbsr_qa.domain.errors import CbsrError, ConfigError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._shared import refuse_unknown


class CalibrationCheck:
    """A run's loads against the calibration of the same sensor.

    ``sensitivity_change`` [%]: of estimated over measured force, all loads together; ``calibrated_force_error`` [N]
    of every load; ``reference_change`` [%] of the unloaded readings, root mean square; ``noise_ratio`` [1] of a
    reading's noise now over that of the calibration.

    Parameters
    ----------
    calibration : a calibration file; by default the latest of the sensor's serial in the calibrations folder.
    """

    measures: ClassVar[dict[str, str]] = {
        "sensitivity_change": "%",
        "calibrated_force_error": "N",
        "reference_change": "%",
        "noise_ratio": "1",
    }

    def __init__(self, **options: Any) -> None:
        refuse_unknown("calibration-check", options, ("calibration",))
        given = options.get("calibration")
        if given is not None and not (isinstance(given, str) and given):
            raise ConfigError(
                f"metric 'calibration-check': calibration is {given!r}", remedy="it is the path of a calibration file"
            )
        self._path = None if given is None else Path(given)
        # Before anything moves: five minutes at the station are not spent on a file that is not there.
        if self._path is not None and not self._path.is_file():
            raise ConfigError(
                f"metric 'calibration-check': there is no file {given}",
                remedy="it is the path of a calibration file, from the folder the run is started in",
            )

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; without a calibration that fits, everything is without value and says why."""
        try:
            path = self._path or _latest(run.record.identity.sensor.serial)
            found = recheck(run, Calibration(read_contained(path)))
        except CbsrError as error:
            return tuple(Measurement(name, None, unit, how=error.reason) for name, unit in self.measures.items())
        return _measurements(found, f"against {path.name}")


def _latest(serial: str) -> Path:
    """The newest calibration file of a sensor: runs are named by when they began."""
    folder = calibrations_folder()
    files = sorted(file for file in folder.glob("*.h5") if file.name.rpartition("-")[0].startswith(f"{serial}-"))
    exact = [file for file in files if _serial(file) == serial]
    if not exact:
        raise ConfigError(
            f"there is no calibration of sensor {serial} in {folder}",
            remedy="calibrate it first, or name a file: calibration-check = { calibration = … }",
        )
    return exact[-1]


def _serial(file: Path) -> str:
    """Serial in the name of a calibration file, ``<serial>-<run>.h5``; a run is a UUID of 36 characters."""
    return file.stem[:-37]


def _measurements(found: Recheck, how: str) -> tuple[Measurement, ...]:
    of_loads = tuple(
        Measurement(
            "calibrated_force_error",
            one.estimated_N - one.measured_N,
            "N",
            one.stderr_N,
            phase=one.load.phase,
            location=one.load.record.load.label,
            trial=one.load.record.load.trial,
            load=one.load.record.index,
            strain=one.load.record.load.strain,
            how=f"{how}: {one.estimated_N:.3g} N where the load cell has {one.measured_N:.3g} N",
        )
        for one in found.loads
    )
    change, stderr = 100 * (found.sensitivity - 1), 100 * found.sensitivity_stderr
    of = f"{how}, {len(found.loads)} loads"
    return (
        Measurement("sensitivity_change", change, "%", stderr, how=of),
        *of_loads,
        Measurement("reference_change", 100 * found.reference_change, "%", how=how),
        Measurement("noise_ratio", found.noise_ratio, "1", how=how),
    )
