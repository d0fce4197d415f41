"""Explanation of a scene: its effects, their cost, disabled effects, and what is not modelled."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from cbsr_qa.domain.errors import PluginError
from cbsr_qa.domain.plan.world import SceneSetting
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.simulate.chain import NOT_MODELLED, build_chain
from cbsr_qa.studies.scenes.costs import Costs, Watched, measure_costs
from cbsr_qa.studies.scenes.setting import SceneSetup, name_scene_file, set_up


@dataclass(frozen=True, slots=True)
class ExplainedEffect:
    """An effect, enabled or disabled.

    Parameters
    ----------
    perturbs : stage of the effect; empty if unknown before the effect is created.
    cost_ms_per_frame : cost, with a share of the work done once per scene; 0 if disabled, None if not measured.
    parameters : parameters from the scene.
    does : first line of its docstring.
    each_ms, once_ms : cost per frame without that share, and total once per scene.
    """

    name: str
    on: bool
    needs: tuple[str, ...]
    perturbs: str
    cost_ms_per_frame: float | None
    parameters: Mapping[str, Any]
    does: str
    each_ms: float | None = None
    once_ms: float | None = None


@dataclass(frozen=True, slots=True)
class Explained:
    """Content of a scene.

    Parameters
    ----------
    effects : enabled ones in order, then the others by name.
    frames : number of frames in the scene's recording; None without one.
    frame_ms, compute_s : measured, or None.
    measured_with : sensor type, material and load, in words; None if nothing was measured.
    """

    scene: str
    effects: tuple[ExplainedEffect, ...]
    not_modelled: tuple[str, ...]
    frames: int | None
    frame_ms: float | None
    compute_s: float | None
    measured_with: str | None


def explain_scene(
    scene: str,
    *,
    measure: bool = True,
    tell: Callable[[str], None] = lambda stage: None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Explained:
    """Explain a scene. Every installed effect is imported, unlike in a simulation.

    Parameters
    ----------
    measure : whether to take frames to measure costs.

    Raises
    ------
    RefusedError
        If a file is wrong, or its loads or effects do not fit together.
    """
    plugins = discover()
    setup = set_up(scene, plugins, recorded=False)
    factory = partial(plugins.factory, Kind.EFFECT)
    watched = Watched(factory)
    setting = SceneSetting(
        setup.sensor_type.value,
        setup.material.value,
        setup.plan.indenter,
        setup.plan.seed or 0,
        setup.plan.scene.current_A,
        setup.plan.scene.frame_period_s,
    )
    with name_scene_file(setup.label):
        build_chain(setup.plan.scene, setting, watched)
    costs = None
    if measure:
        tell("measuring the cost of effects")
        costs = measure_costs(setup, factory, progress=progress)
    return Explained(
        scene=setup.plan.scene.name,
        effects=(*_on(setup, watched, costs), *_list_inactive(setup, plugins)),
        not_modelled=(*setup.plan.scene.not_modelled, *NOT_MODELLED),
        frames=setup.plan.frame_count or None,
        frame_ms=None if costs is None else costs.frame_ms,
        compute_s=None if costs is None or not setup.plan.frame_count else costs.compute_s,
        measured_with=None if costs is None else _describe_setting(setup),
    )


def _describe_setting(setup: SceneSetup) -> str:
    plan = setup.plan
    sensor = f"{setup.sensor_type.value.name} of {setup.material.value.name}"
    if plan.sensor_type is None:
        sensor += " (the scene leaves the sensor to a station)"
    if plan.duration_s is None and not plan.loads:
        sensor += ", one central load (the scene has none)"
    return sensor


def _on(setup: SceneSetup, watched: Watched, costs: Costs | None) -> Iterator[ExplainedEffect]:
    for choice in setup.plan.scene.effects:
        effect = watched.effects[choice.name]
        yield ExplainedEffect(
            name=choice.name,
            on=True,
            needs=tuple(effect.needs),
            perturbs=effect.perturbs,
            cost_ms_per_frame=None if costs is None else costs.effect_ms[choice.name],
            parameters=choice.options,
            does=_read_purpose(type(effect)),
            each_ms=None if costs is None else costs.each_ms[choice.name],
            once_ms=None if costs is None else costs.once_ms[choice.name],
        )


def _list_inactive(setup: SceneSetup, plugins: Plugins) -> Iterator[ExplainedEffect]:
    active_names = {choice.name for choice in setup.plan.scene.effects}
    for name in plugins.names(Kind.EFFECT):
        if name in active_names:
            continue
        try:
            factory: Any = plugins.factory(Kind.EFFECT, name)
        except PluginError as error:
            yield ExplainedEffect(name, False, (), "", 0.0, {}, error.reason)
            continue
        needs, perturbs = getattr(factory, "needs", ()), getattr(factory, "perturbs", "")
        # Unknown before creation if the factory is not a class, or the effect decides when created.
        known_needs = tuple(needs) if isinstance(needs, tuple | list) else ()
        stage = perturbs if isinstance(perturbs, str) else ""
        yield ExplainedEffect(name, False, known_needs, stage, 0.0, {}, _read_purpose(factory))


def _read_purpose(of: object) -> str:
    return (inspect.getdoc(of) or "").strip().partition("\n")[0]
