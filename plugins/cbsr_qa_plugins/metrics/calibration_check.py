"""Whether a sensor's calibration still holds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field

from cbsr_qa.analysis.verification import Verification, verify_calibration
from cbsr_qa.calibration.file.hdf5 import read_contained
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.config.paths import calibrations_folder
from cbsr_qa.plugin import CbsrError, ConfigError, Measurement, PluginOptions, Problem, RunObservation, WithOptions
from cbsr_qa.system.words import quote_value
from cbsr_qa_plugins.metrics._shared import measurement_of_load


class CalibrationCheck(WithOptions):
    """A run's loads against the calibration of the same sensor.

    ``sensitivity_change`` [%]: of estimated over measured force, all loads together; ``calibrated_force_error`` [N]
    of every load; ``reference_change`` [%] of the unloaded readings, root mean square; ``noise_ratio`` [1] of a
    reading's noise now over that of the calibration.

    Parameters
    ----------
    calibration : a calibration file; by default the latest of the sensor's serial in the calibrations folder.
    """

    class Options(PluginOptions):
        calibration: Annotated[str, Field(min_length=1)] | None = None

        def problems(self) -> Iterator[Problem]:
            """Five minutes at the station are not spent on a file that is not there."""
            if self.calibration is not None and not Path(self.calibration).is_file():
                problem = "it must be the path of a calibration file, from the folder the run is started in"
                yield Problem(("calibration",), f"is {quote_value(self.calibration)}, where no file is", problem)

    measures: ClassVar[dict[str, str]] = {
        "sensitivity_change": "%",
        "calibrated_force_error": "N",
        "reference_change": "%",
        "noise_ratio": "1",
    }

    options: Options

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; without a calibration that fits, everything is without value and says why."""
        try:
            calibration = self.options.calibration
            path = Path(calibration) if calibration else _latest(run.record.identity.sensor.serial)
            verification = verify_calibration(run, Calibration(read_contained(path)))
        except CbsrError as error:
            return tuple(Measurement(name, None, unit, how=error.reason) for name, unit in self.measures.items())
        return _measurements(verification, f"against {path.name}")


def _latest(serial: str) -> Path:
    """The newest calibration file of a sensor: runs are named by when they began."""
    folder = calibrations_folder()
    files = sorted(file for file in folder.glob("*.h5") if file.name.rpartition("-")[0].startswith(f"{serial}-"))
    # Named <serial>-<run>.h5; a run is a UUID of 36 characters.
    exact = [file for file in files if file.stem[:-37] == serial]
    if not exact:
        raise ConfigError(
            f"there is no calibration of sensor {serial} in {folder}",
            remedy="calibrate it first, or name a file: calibration-check = { calibration = … }",
        )
    return exact[-1]


def _measurements(verified: Verification, how: str) -> tuple[Measurement, ...]:
    of_loads = tuple(
        measurement_of_load(
            load.load,
            "calibrated_force_error",
            load.estimated_N - load.measured_N,
            "N",
            uncertainty=load.stderr_N,
            how=f"{how}: {load.estimated_N:.3g} N where the load cell has {load.measured_N:.3g} N; ± is"
            f" {verified.error}",
        )
        for load in verified.loads
    )
    change, stderr = 100 * (verified.sensitivity - 1), 100 * verified.sensitivity_stderr
    together = f"{how}, {len(verified.loads)} loads; ± is {verified.error}"
    return (
        Measurement("sensitivity_change", change, "%", stderr, how=together),
        *of_loads,
        Measurement("reference_change", 100 * verified.reference_change, "%", how=how),
        Measurement("noise_ratio", verified.noise_ratio, "1", how=how),
    )
