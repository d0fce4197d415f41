"""Hard cases of deciding which press is next: coinciding places, many presses of one, targets out of reach."""

from typing import Final

import numpy as np

from cbsr_qa.calibration.sheet.response_map import ResponseMap, learn_response
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.station.decisions import PressDecisions
from cbsr_qa.station.forecasts import forecast_presses
from cbsr_qa.station.setup import plan_of
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import exact_map, largest_relative_error, map_condition
from cbsr_qa.studies.simulated import configuration_of, copy_shipped

AREA: Final = Area("decisions")
_PRESSED: Final = "the variance of the map with that press, in fifty digits"
NINE: Final[Array] = np.array(NINE_LOCATIONS_MM)
_TARGETS: Final[Array] = np.array([[3.0, -4.0], [20.0, -10.0], [33.0, 21.0]])
_NOISE: Final = 1e-4


def check_variance_after(places_mm: Array, candidate_mm: Array, noise: float = _NOISE) -> Answer:
    """Variance at some places after one more press, by the likeliest process, against the map that has the press."""
    values = 0.1 * np.sin(places_mm[:, 0] / 20) + 0.05 * np.cos(places_mm[:, 1] / 15)
    variance = np.full(len(values), noise)
    learned = learn_response(places_mm, values, variance, radius_mm=50.0)
    likeliest = learned.members[int(np.argmax(learned.weights))]
    single = ResponseMap(learned.places_mm, (likeliest,), np.ones(1))
    after = single.variance_after(candidate_mm[None], _TARGETS, noise)[0, 0]
    pressed = np.vstack([places_mm, candidate_mm]), np.append(values, 0.0), np.append(variance, noise)
    _, exact = exact_map(single, *pressed, _TARGETS)
    return answer_from_condition(largest_relative_error(after, exact), map_condition(single, pressed[0], pressed[2]))


def target(target_N: float) -> None:
    """Forecast of the shipped recipe ``adaptive`` with another target."""
    recipe, plugins = copy_shipped(DocumentKind.RECIPE, "adaptive"), discover()
    for phase in recipe["phases"]:
        phase.update({"target_N": target_N} if "target_N" in phase else {})
    configuration = configuration_of(copy_shipped(DocumentKind.STATION, "simulated"), recipe, seed=1)
    plan = plan_of(configuration, plugins)
    decisions = PressDecisions.from_configuration(configuration, plan, plugins)
    forecast_presses(decisions, plan, configuration.recipe.analysis)


@AREA.against(_PRESSED)
def press_where_one_was_pressed() -> Answer:
    """A place that was pressed before: the new press says the same again."""
    return check_variance_after(NINE, NINE[4])


@AREA.against(_PRESSED)
def press_a_nanometre_beside_another() -> Answer:
    """Two places that nearly coincide: the covariance of both is singular but for the noise."""
    return check_variance_after(NINE, NINE[4] + [1e-6, 0.0])


@AREA.against(_PRESSED)
def press_after_fifty_at_one_place() -> Answer:
    """One place pressed fifty times, eight others once: all but the mean of the fifty is redundant."""
    return check_variance_after(np.vstack([NINE, np.tile(NINE[0], (49, 1))]), NINE[0])


@AREA.against(_PRESSED)
def press_without_noise() -> Answer:
    """Loads without noise: one more at the same place leaves a variance that is the difference of equal numbers."""
    return check_variance_after(NINE, np.array([10.0, 12.0]), noise=0.0)


@AREA.refuses(ConfigError)
def target_below_the_noise() -> None:
    """A target that the noise of readings alone exceeds: no number of presses reaches it."""
    target(1e-3)


@AREA.refuses(ConfigError)
def one_place_to_choose_from() -> None:
    """One place to press: no map follows from it, and nothing is left to decide."""
    choice = PluginChoice("adaptive-grid", {"target_N": 0.1, "locations_mm": [[0.0, 0.0]]})
    create_plugin(discover(), Kind.SEQUENCE, choice, "phase 'one place'")


@AREA.refuses(ConfigError)
def coinciding_places_to_choose_from() -> None:
    """The same place listed twice, of which each may be pressed once."""
    choice = PluginChoice("adaptive-grid", {"target_N": 0.1, "locations_mm": [[0.0, 0.0]] * 3, "at_most": 3})
    create_plugin(discover(), Kind.SEQUENCE, choice, "phase 'the same place'")
