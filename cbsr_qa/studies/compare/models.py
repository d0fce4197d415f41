"""Models of metrics: each is fitted by itself, then all are tested together for disturbances common to them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossings import Crossing
from cbsr_qa.stats.difference import Contrast
from cbsr_qa.stats.mixed_model.model import Fit, fit
from cbsr_qa.stats.mixed_model.repeats import average_repeats
from cbsr_qa.stats.mixed_model.scatter import fit_scatter
from cbsr_qa.stats.mixed_model.sessions import SessionMeans, add_sessions, correlate, fit_session_means, lack_of_fit

_AVERAGED_NOTE: Final = (
    "sensors read more differently at other stations than in repeated runs: the mean of a sensor's runs at a station "
    "counts once"
)
_SCATTER_NOTE: Final = (
    "{low} scatters least and {high} most, {times} times as much: each is weighted by its own scatter"
)
_SESSIONS_NOTE: Final = (
    "groups differ from station to station by more than their sensors explain (lack of fit, p = {p:.1g}): intervals "
    "include a deviation of {deviation:.2g} between a group's sessions at stations"
)
#: Largest ratio of deviations that is stated: it would be infinite for a group whose values are all equal.
_MOST_TIMES: Final = 100


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The model of one metric, or the reason for none.

    Parameters
    ----------
    fit : the fitted model; None for the reason ``why``.
    of_stations : whether the compared groups are the stations.
    sessions : means of groups at stations; None where no departure from the model can show.
    """

    fit: Fit | None
    why: str
    of_stations: bool
    sessions: SessionMeans | None = None

    def difference(self, group: str, reference: str) -> Contrast:
        """Return group − reference; NumericsError if the design cannot estimate it."""
        if self.fit is None:
            raise NumericsError(self.why)
        estimate = self.fit.station_difference if self.of_stations else self.fit.group_difference
        return estimate(group, reference)


def fit_model(design: Crossing, values: Array, what: str, *, of_stations: bool) -> Fitted:
    """Fit the model of one metric to the runs that have a value.

    Parameters
    ----------
    values : (N,) one for each run of ``design``; NaN where missing.
    what : name of the metric, for messages.
    of_stations : whether the compared groups are the stations.
    """
    has_value = ~np.isnan(values)
    if not has_value.any():
        return Fitted(None, "nothing was measured", of_stations)
    if not has_value.all():
        design, values = design.select_runs(has_value), values[has_value]
    notes: list[str] = []
    try:
        if averaged := average_repeats(design, values):
            design, values = averaged
            notes.append(_AVERAGED_NOTE)
        alike = fit(design, values, what)
        if len(alike.design.group) < len(values):  # runs of a sensor cannot be told apart: the first counts
            values = values[design.first_runs()]
        final_fit = fit_scatter(alike, values)
        if final_fit.scatter is not None:
            deviations, names = final_fit.scatter.sensor_deviations, final_fit.design.groups
            low, high = int(np.argmin(deviations)), int(np.argmax(deviations))
            ratio = float(deviations[high] / deviations[low])
            times = f"{ratio:.2g}" if ratio < _MOST_TIMES else f"more than {_MOST_TIMES}"
            notes.append(_SCATTER_NOTE.format(low=names[low], high=names[high], times=times))
        final_fit = replace(final_fit, notes=(*final_fit.notes, *notes))
        return Fitted(final_fit, "", of_stations, fit_session_means(final_fit, values))
    except NumericsError as error:
        return Fitted(None, str(error).replace("\n", "; "), of_stations)


def include_sessions(models: Sequence[Fitted]) -> list[Fitted]:
    """Test the models of all metrics together for lack of fit, and add sessions to them where it is shown.

    A session is a group at a station: conditions peculiar to it disturb all metrics, or most.
    """
    places = [index for index, model in enumerate(models) if model.sessions is not None]
    sessions = [model.sessions for model in models if model.sessions is not None]
    if not sessions:
        return list(models)
    lack = lack_of_fit([means.departure() for means in sessions], correlate(sessions))
    with_sessions = list(models)
    for index, ratio in zip(places, lack.ratios, strict=False):  # no ratios where nothing is shown
        model = models[index]
        if ratio.value > 1 and model.fit is not None and model.sessions is not None:
            session_fit = add_sessions(model.fit, model.sessions, ratio)
            note = _SESSIONS_NOTE.format(p=lack.p_value, deviation=session_fit.session_deviation or 0.0)
            with_sessions[index] = replace(model, fit=replace(session_fit, notes=(*session_fit.notes, note)))
    return with_sessions
