"""Checks of recipe and plan before anything moves."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Final

from cbsr_qa.analysis.run.reference import check_weighing
from cbsr_qa.calibration.file.keys import SigningKey, signing_key
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import CbsrError, ConfigError, RefusedError
from cbsr_qa.domain.imaging import linear
from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.plan.plan import Recipe, Station
from cbsr_qa.domain.plan.steps import AcquireFrames, MarkUnloaded, Press, Role
from cbsr_qa.domain.results.characterisation import STRIP_MEASURES
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.readings import FEWEST_FRAMES
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.failures import blame_plugin
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.station.plan import Plan
from cbsr_qa.station.setup import plan_of

_WEIGHING: Final = 'analysis.noise_weighting = "measured" needs'
_EQUAL: Final = 'set analysis.noise_weighting = "equal"'
_LESS: Final = "lower analysis.noise_floor_frames"


def check_configuration(configuration: Configuration, plugins: Plugins) -> None:
    """Check recipe, plugins and limits before anything moves. Raise RefusedError if one fails."""
    check_recipe(configuration.recipe, configuration.sensor_type, plugins)
    planned = plan_of(configuration, plugins)
    station_key(configuration.station)
    check_unloaded(planned, configuration.recipe)
    check_cycles(planned, configuration.recipe)


def check_recipe(recipe: Recipe, sensor_type: SensorType, plugins: Plugins) -> None:
    """Check that the plugins a recipe needs are installed, accept their options, and can image the sensor.

    Raises
    ------
    PluginError, ConfigError, NumericsError
        Naming the recipe, what is wrong in it, and what is allowed.
    """
    try:
        for name in (*recipe.sections, *(recipe.annexes_if_passed or ())):
            plugins.factory(Kind.SECTION, name)
        if recipe.characterisation is not None:
            from cbsr_qa.eit.loads.bodies import check_strip  # other recipes press no strip

            check_strip(sensor_type)
            _check_named(recipe.limits, STRIP_MEASURES)
            return
        reconstruction = create_plugin(plugins, Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]")
        check_weighing(reconstruction, recipe.reconstruction.name, recipe.analysis)
        metrics = {choice.name: create_plugin(plugins, Kind.METRIC, choice, "[metrics]") for choice in recipe.metrics}
        _check_limits(recipe.limits, metrics)
        problem = imaging_problem(sensor_type)
        with blame_plugin(f"reconstruction {recipe.reconstruction.name!r}"):
            linear(reconstruction.prepare(problem))
    except CbsrError as error:
        raise type(error)(f"recipe {recipe.name!r}: {error.reason}", remedy=error.remedy) from error


def check_unloaded(plan: Plan, recipe: Recipe) -> None:
    """Check that enough unloaded frames are taken for noise floor, reference and noise weighting.

    Raises
    ------
    ConfigError
        If the first phase that marks the sheet as unloaded takes fewer.
    """
    split = recipe.analysis.noise_floor_frames + 1
    weighed = FEWEST_FRAMES if recipe.analysis.noise_weighting == "measured" else 0
    needed = max(split, weighed)
    for phase in plan.phases:
        count = _count_unloaded_frames(phase.steps(plan.context))
        if count is None:
            continue
        if count < needed:
            raise ConfigError(
                f"recipe {recipe.name!r}: phase {phase.name!r} takes {count} unloaded frames, but"
                f" {'analysis.noise_floor_frames and the reference need' if count < split else _WEIGHING} {needed}",
                remedy=f"take more unloaded frames in that phase, or {_LESS if count < split else _EQUAL}",
            )
        return


def check_cycles(plan: Plan, recipe: Recipe) -> None:
    """Check that a recipe for a strip presses cycles, all in one place. Raise ConfigError if not."""
    if recipe.characterisation is None:
        return
    meant = [phase for phase in plan.phases if getattr(phase.sequence, "role", None) is Role.CHARACTERISATION]
    steps = [step for phase in meant for step in phase.steps(plan.context)]
    places = {(step.load.x_mm, step.load.y_mm) for step in steps if isinstance(step, Press)}
    if len(places) != 1:
        phases_found = f"press cycles at {len(places)} places" if places else "no phase of press cycles"
        raise ConfigError(
            f"recipe {recipe.name!r} has [characterisation] and {phases_found}; a strip is pressed at one place",
            remedy='give it one phase with sequence = "characterisation"',
        )


def station_key(station: Station) -> SigningKey | None:
    """Return the key that signs a station's calibrations, or None. Raise RefusedError if it cannot be used."""
    if station.signing_key is None:
        return None
    try:
        return signing_key(station.signing_key)
    except RefusedError as error:
        where = f"station {station.name!r}: calibrations.signing_key: "
        raise type(error)(f"{where}{error.reason}", remedy=error.remedy) from error


def _check_limits(limits: Iterable[Limit], metrics: Mapping[str, object]) -> None:
    measured: dict[str, str] = {}
    for name, metric in metrics.items():
        measures = getattr(metric, "measures", None)
        if measures is None:
            raise ConfigError(
                f"metric {name!r} does not say what it measures",
                remedy="its `measures` must map names of measurements to units",
            )
        measured |= measures
    _check_named(limits, measured)


def _check_named(limits: Iterable[Limit], measured: Mapping[str, str]) -> None:
    for limit in limits:
        if limit.measurement not in measured:
            near = get_close_matches(limit.measurement, measured, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise ConfigError(
                f"no metric of this recipe measures {limit.measurement!r}, which a limit names",
                remedy=f"{hint}measured: {', '.join(sorted(measured))}",
            )
        if limit.unit != measured[limit.measurement]:
            raise ConfigError(
                f"the limit of {limit.measurement} is in {limit.unit!r}; it is measured in"
                f" {measured[limit.measurement]!r}",
                remedy="give the limit in the measurement's unit",
            )


def _count_unloaded_frames(steps: Iterable[object]) -> int | None:
    """Count frames between the first mark and the next press; None without a mark."""
    frame_count: int | None = None
    for step in steps:
        match step:
            case MarkUnloaded():
                frame_count = frame_count or 0
            case AcquireFrames(count=count) if frame_count is not None:
                frame_count += count
            case Press() if frame_count is not None:
                return frame_count
    return frame_count
