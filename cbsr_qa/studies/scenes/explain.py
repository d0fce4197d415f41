"""Explanation of a scene: its effects, their cost, disabled effects, and what is not modelled."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date, time
from typing import Any

from cbsr_qa.domain import PluginError
from cbsr_qa.domain.plan import SceneSetting
from cbsr_qa.plugin import Kind, Plugins, discover
from cbsr_qa.simulate import NOT_MODELLED, build_chain
from cbsr_qa.studies.scenes.costs import Costs, Watched, measured_costs
from cbsr_qa.studies.scenes.setting import SceneSetup, effects_of, naming, set_up


@dataclass(frozen=True, slots=True)
class ExplainedEffect:
    """An effect, enabled or disabled.

    Parameters
    ----------
    cost_ms : a frame, with its share of what happens once a scene; 0 of one that is off, None where not measured.
    parameters : as the scene gives them.
    does : first line of what its author says of it.
    each_ms, once_ms : what a frame costs without that share, and what happens once a scene, in all.
    """

    name: str
    on: bool
    needs: tuple[str, ...]
    perturbs: str
    cost_ms: float | None
    parameters: Mapping[str, Any]
    does: str
    each_ms: float | None = None
    once_ms: float | None = None

    def document(self) -> dict[str, Any]:
        """Return its part of what ``--json`` prints."""
        return {
            "name": self.name,
            "on": self.on,
            "needs": list(self.needs),
            "perturbs": self.perturbs,
            "cost_ms_per_frame": self.cost_ms,
            "parameters": _in_json(self.parameters),
            "does": self.does,
        }


@dataclass(frozen=True, slots=True)
class Explained:
    """Content of a scene.

    Parameters
    ----------
    effects : those that are on in their order, then the others by name.
    frames : of the scene's recording; None without one.
    frame_ms, compute_s : measured; None where nothing was.
    measured_with : sensor type, material and load, in words.
    """

    scene: str
    effects: tuple[ExplainedEffect, ...]
    not_modelled: tuple[str, ...]
    frames: int | None
    frame_ms: float | None
    compute_s: float | None
    measured_with: str

    def document(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        return {
            "scene": self.scene,
            "effects": [effect.document() for effect in self.effects],
            "not_modelled": list(self.not_modelled),
            "frames": self.frames,
            "frame_ms": self.frame_ms,
            "compute_s": self.compute_s,
            "measured_with": None if self.frame_ms is None else self.measured_with,
        }


def explain_scene(
    scene: str,
    *,
    measure: bool = True,
    tell: Callable[[str], None] = lambda stage: None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Explained:
    """Explain a scene. Every installed effect is imported, which simulating it does not do.

    Parameters
    ----------
    scene : path or shipped name.
    measure : whether frames are taken to measure costs.
    tell, progress : told what the computer is busy with, and how many of its measurements are done.

    Raises
    ------
    RefusedError
        If a file is wrong, or its loads or effects do not fit together.
    """
    plugins = discover()
    setup = set_up(scene, recorded=False)
    watched = Watched(effects_of(plugins))
    setting = SceneSetting(
        setup.sensor_type.value,
        setup.material.value,
        setup.plan.indenter,
        setup.plan.seed or 0,
        setup.plan.scene.current_A,
        setup.plan.scene.frame_period_s,
    )
    with naming(setup.label):
        build_chain(setup.plan.scene, setting, watched)
    costs = _measured(setup, plugins, tell, progress) if measure else None
    return Explained(
        setup.plan.scene.name,
        (*_on(setup, watched, costs), *_off(setup, plugins)),
        (*setup.plan.scene.not_modelled, *NOT_MODELLED),
        setup.plan.frame_count or None,
        None if costs is None else costs.frame_ms,
        None if costs is None or not setup.plan.frame_count else costs.compute_s,
        _measured_with(setup),
    )


def _measured(
    setup: SceneSetup, plugins: Plugins, tell: Callable[[str], None], progress: Callable[[int, int], None]
) -> Costs:
    tell("measuring the cost of effects")
    return measured_costs(setup, effects_of(plugins), progress=progress)


def _measured_with(setup: SceneSetup) -> str:
    plan = setup.plan
    sensor = f"{setup.sensor_type.value.name} of {setup.material.value.name}"
    if plan.sensor_type is None:
        sensor += " (the scene leaves the sensor to a station)"
    if plan.duration_s is None and not plan.loads:
        sensor += ", one central load (the scene has none)"
    return sensor


def _on(setup: SceneSetup, watched: Watched, costs: Costs | None) -> list[ExplainedEffect]:
    return [
        ExplainedEffect(
            choice.name,
            True,
            tuple(watched.effects[choice.name].needs),
            watched.effects[choice.name].perturbs,
            None if costs is None else costs.effect_ms[choice.name],
            choice.options,
            _does(type(watched.effects[choice.name])),
            None if costs is None else costs.each_ms[choice.name],
            None if costs is None else costs.once_ms[choice.name],
        )
        for choice in setup.plan.scene.effects
    ]


def _off(setup: SceneSetup, plugins: Plugins) -> list[ExplainedEffect]:
    on = {choice.name for choice in setup.plan.scene.effects}
    found = []
    for name in plugins.names(Kind.EFFECT):
        if name in on:
            continue
        try:
            factory: Any = plugins.factory(Kind.EFFECT, name)
        except PluginError as error:
            found.append(ExplainedEffect(name, False, (), "", 0.0, {}, error.reason))
            continue
        needs, perturbs = getattr(factory, "needs", ()), getattr(factory, "perturbs", "")
        # Of a factory that is no class, or an effect that decides as it is made, they are not known before.
        known = tuple(needs) if isinstance(needs, tuple | list) else ()
        stage = perturbs if isinstance(perturbs, str) else ""
        found.append(ExplainedEffect(name, False, known, stage, 0.0, {}, _does(factory)))
    return found


def _in_json(value: Any) -> Any:
    """What TOML holds, as JSON holds it: dates and times become texts as they stand in the file."""
    if isinstance(value, Mapping):
        return {key: _in_json(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_in_json(each) for each in value]
    return value.isoformat() if isinstance(value, date | time) else value


def _does(of: object) -> str:
    said = inspect.getdoc(of) or ""
    return said.strip().partition("\n")[0]
