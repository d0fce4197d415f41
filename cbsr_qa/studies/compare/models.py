"""Models of metrics: each by itself, then all together for what disturbs them alike."""

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

_AVERAGED: Final = (
    "sensors read more differently at other stations than in repeated runs: the mean of a sensor's runs at a station "
    "counts once"
)
_SCATTER: Final = (
    "{low} scatters least and {high} most, {times:.2g} times as much: each is weighted by its own scatter"
)
_SESSIONS: Final = (
    "groups differ from station to station by more than their sensors explain (lack of fit, p = {p:.1g}): intervals "
    "include a deviation of {deviation:.2g} between a group's sessions at stations"
)


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The model of one metric, or the reason for none.

    Parameters
    ----------
    of_stations : whether its stations are the compared groups.
    sessions : means of groups at stations; None where they leave no departure from the model to see.
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
    """Fit the model to the runs (N,) that have a value; NaN where missing."""
    has_value = ~np.isnan(values)
    if not has_value.any():
        return Fitted(None, "nothing was measured", of_stations)
    if not has_value.all():
        design, values = design.select_runs(has_value), values[has_value]
    notes: list[str] = []
    try:
        if averaged := average_repeats(design, values):
            design, values = averaged
            notes.append(_AVERAGED)
        alike = fit(design, values, what)
        if len(alike.design.group) < len(values):  # runs of a sensor cannot be told apart: the first counts
            values = values[design.first_runs()]
        fitted = fit_scatter(alike, values)
        if fitted.scatter is not None:
            variances, names = fitted.scatter.sensor_variances, fitted.design.groups
            low, high = int(np.argmin(variances)), int(np.argmax(variances))
            times = float(np.sqrt(variances[high] / variances[low]))
            notes.append(_SCATTER.format(low=names[low], high=names[high], times=times))
        fitted = replace(fitted, notes=(*fitted.notes, *notes))
        return Fitted(fitted, "", of_stations, fit_session_means(fitted, values))
    except NumericsError as error:
        return Fitted(None, str(error).replace("\n", "; "), of_stations)


def include_sessions(models: Sequence[Fitted]) -> list[Fitted]:
    """Test the models of all metrics together for lack of fit, and add sessions to them where it is shown.

    A session is a group at a station: what was particular to it then, in all metrics or most.
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
            fitted = add_sessions(model.fit, model.sessions, ratio)
            note = _SESSIONS.format(p=lack.p_value, deviation=fitted.session_deviation or 0.0)
            with_sessions[index] = replace(model, fit=replace(fitted, notes=(*fitted.notes, note)))
    return with_sessions
