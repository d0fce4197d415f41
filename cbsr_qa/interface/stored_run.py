"""One stored run."""

from functools import cached_property
from typing import TYPE_CHECKING, Any

from cbsr_qa.app.export.export import run_attributes
from cbsr_qa.app.export.formats import ExportTable
from cbsr_qa.app.export.frames import join_channels, run_frames
from cbsr_qa.app.export.netcdf import frame_variables
from cbsr_qa.app.run.outcome import RunOutcome, run_outcome
from cbsr_qa.app.run.render import outcome_of_stored
from cbsr_qa.app.shift.lists import ListRequest
from cbsr_qa.calibration.file.hdf5 import calibration_of
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import CalibrationError, StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.interface.frames import dataset_of
from cbsr_qa.interface.plots import plot_run
from cbsr_qa.interface.result import Result
from cbsr_qa.interface.tables import table_of
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.store.opening import open_store

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes


class Run(Result[RunOutcome]):
    """A stored run of a sensor. ``repr`` and page are those of ``cbsr-qa run``.

    Parameters
    ----------
    run : its identifier, or a serial number for its latest run.
    database : as :func:`open_database` takes it.
    outcome : if it is known already; else it is read from the store when it is first asked for.
    """

    def __init__(
        self, run: str, database: str | None = None, outcome: CommandOutcome[RunOutcome] | None = None
    ) -> None:
        self._url = database_url(database)
        self._given = outcome
        with open_store(self._url, create=False) as store:
            #: Identifier of the run.
            self.run: str = store.runs.resolve(run)

    @cached_property
    def _outcome(self) -> CommandOutcome[RunOutcome]:
        if self._given is not None:
            return self._given
        with open_store(self._url, create=False) as store:
            return run_outcome(outcome_of_stored(self.run, store, discover()))

    @cached_property
    def record(self) -> RunRecord:
        """Everything that was recorded: identity, phases, frames, samples, presses."""
        with open_store(self._url, create=False) as store:
            return store.runs.load(self.run)

    @property
    def serial(self) -> str:
        """Serial number of the sensor."""
        return self.record.identity.sensor.serial

    @property
    def verdict(self) -> Outcome | None:
        """What counts now, an override included: a text such as ``"pass"``; None if it did not finish.

        StoreError if the run was altered since it was stored.
        """
        return self._read_listed().verdict

    def _read_listed(self) -> ListedRun:
        with open_store(self._url, create=False) as store:
            (listed,) = store.lists.read_runs(self._only)
        if listed.altered:
            raise StoreError(listed.altered, remedy="restore the database from a copy")
        return listed

    @property
    def _only(self) -> RunSelection:
        return RunSelection(up_to=self.run, latest=1)

    def measurements(self) -> "pd.DataFrame":
        """Return the measurements, one a row; see :meth:`Database.measurements`."""
        return table_of(self._url, ListRequest(self._only, latest=1), ExportTable.MEASUREMENTS)

    def frames(self, phase: str | None = None) -> "xr.Dataset":
        """Return frames with coordinates and units: the content of ``cbsr-qa export RUN --to frames.nc``.

        Parameters
        ----------
        phase : name of the only phase; None for all.

        Raises
        ------
        CbsrError
            If there is no such phase, it holds no frames, or phases differ in unit or shape.
        """
        record = self.record
        phases = record.phases if phase is None else (record.phase(phase),)
        variables = frame_variables(record.sensor_type, run_frames(record, phases), join_channels(phases))
        return dataset_of(variables, run_attributes(record, self._read_listed()))

    def calibration(self) -> Calibration:
        """Return the sensor's calibration that this run issued. CalibrationError if it issued none."""
        issued: Any = self.result.result.calibration
        if issued is None:
            raise CalibrationError(
                f"run {self.run} of sensor {self.serial} issued no calibration: {self.result.calibration_why}"
            )
        with open_store(self._url, create=False) as store:
            file, digest = store.calibrations.load_file(issued.calibration)
        return Calibration(calibration_of(file, issued=digest))

    def plot(self, axes: "Axes | None" = None) -> "Axes":
        """Draw the force against time, holds shaded; returns the axes. RefusedError if it holds no force."""
        return plot_run(self.record, axes)
