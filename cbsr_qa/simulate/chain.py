"""The effects of a scene as an ordered list of callables; one that is off is not there."""

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from typing import Any, Final, TypeGuard

from cbsr_qa.domain.errors import CbsrError, ConfigError
from cbsr_qa.domain.plan import PluginChoice, Scene
from cbsr_qa.domain.scene import Moment, SceneSetting, SheetDesign, Transcript
from cbsr_qa.interfaces import AnyEffect, Effect, RecordingEffect, SheetEffect, SwitchingEffect

#: ``effect_factory(name)`` returns what makes the effect: ``factory(setting, **parameters)``.
EffectFactory = Callable[[str], Callable[..., Any]]

#: What an effect may perturb, in the order in which a world comes to it.
STAGES: Final = (
    "sheet",
    "position",
    "geometry",
    "times",
    "response",
    "stress",
    "contacts",
    "impedance",
    "source",
    "voltages",
    "force",
    "recording",
)

#: Stages whose effects have a method of their own instead of ``apply``: the method, and what has it.
_OWN_METHODS: Final[Mapping[str, tuple[str, type]]] = {
    "sheet": ("design(design)", SheetEffect),
    "recording": ("record(transcript)", RecordingEffect),
}


class Chain:
    """The effects that are on, by stage, each stage in the scene's order."""

    def __init__(self, effects: Iterable[tuple[str, AnyEffect]]) -> None:
        named = tuple(effects)
        self.names = tuple(name for name, _ in named)
        self._sheet = tuple(e for _, e in named if isinstance(e, SheetEffect))
        self._recording = tuple(e for _, e in named if isinstance(e, RecordingEffect))
        self._stages = {stage: tuple(e for _, e in named if _applies(e, stage)) for stage in STAGES}

    def has(self, stage: str) -> bool:
        """Whether any effect perturbs a stage."""
        return bool(self._stages[stage])

    @property
    def memory_s(self) -> float:
        """How long after a press the response may still feel it; for ever where an effect does not say."""
        return max((getattr(effect, "memory_s", math.inf) for effect in self._stages["response"]), default=0.0)

    def design(self, design: SheetDesign) -> None:
        """Let the effects of the stage ``sheet`` change a sheet before it is made."""
        for effect in self._sheet:
            effect.design(design)

    def record(self, transcript: Transcript) -> None:
        """Let the effects of the stage ``recording`` change how frames are written down."""
        for effect in self._recording:
            effect.record(transcript)

    def apply(self, stage: str, moment: Moment) -> None:
        """Let the effects of a stage change a moment, one after the other."""
        for effect in self._stages[stage]:
            effect.apply(moment)

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        """Times after the first and up to the last [s] at which the impedance jumps."""
        jumping = [effect for effect in self._stages["impedance"] if isinstance(effect, SwitchingEffect)]
        return [at_s for effect in jumping for at_s in effect.switches(moment, first_s, last_s)]


def _applies(effect: AnyEffect, stage: str) -> TypeGuard[Effect]:
    return effect.perturbs == stage and stage not in _OWN_METHODS


def build_chain(scene: Scene, setting: SceneSetting, effect_factory: EffectFactory) -> Chain:
    """Make the effects a scene asks for, in its order.

    Parameters
    ----------
    scene : what is on.
    setting : given to every effect.
    effect_factory : finds an effect's factory by name; only names that are on are asked for.

    Raises
    ------
    ConfigError
        If an effect is on twice, lacks what it needs or comes before it, or before one that is on and that it says it
        acts ``after``; perturbs nothing known, or is given a parameter it does not have.
    PluginError
        If there is no such effect (raised by ``effect_factory``).
    """
    made: dict[str, AnyEffect] = {}
    for choice in scene.effects:
        if choice.name in made:
            raise ConfigError(f"scene {scene.name!r} has effect {choice.name!r} twice", remedy="keep one of them")
        effect = _make(scene.name, choice, setting, effect_factory(choice.name))
        _check_needs(scene, choice.name, effect, made)
        made[choice.name] = effect
    return Chain(made.items())


def _make(scene: str, choice: PluginChoice, setting: SceneSetting, factory: Callable[..., Any]) -> AnyEffect:
    _check_parameters(scene, choice, factory)
    try:
        effect: AnyEffect = factory(setting, **choice.options)
    except CbsrError as error:
        raise ConfigError(f"scene {scene!r}, effect {choice.name!r}: {error.reason}", remedy=error.remedy) from error
    except (TypeError, ValueError) as error:
        raise ConfigError(f"scene {scene!r}, effect {choice.name!r} cannot be made: {error}") from error
    if effect.perturbs not in STAGES:
        raise ConfigError(
            f"effect {choice.name!r} perturbs {effect.perturbs!r}",
            remedy=f"an effect perturbs one of {', '.join(STAGES)}",
        )
    method, protocol = _OWN_METHODS.get(effect.perturbs, ("apply(moment)", Effect))
    if not isinstance(effect, protocol):
        raise ConfigError(
            f"effect {choice.name!r} perturbs {effect.perturbs!r} and lacks the method for it",
            remedy=f"an effect that perturbs {effect.perturbs!r} has {method}",
        )
    return effect


def _check_parameters(scene: str, choice: PluginChoice, factory: Callable[..., Any]) -> None:
    parameters = list(inspect.signature(factory).parameters.values())[1:]
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return
    known = {p.name: p for p in parameters}
    where = f"scene {scene!r}, effect {choice.name!r}"
    allowed = f"its parameters are {', '.join(known)}" if known else "it has no parameters"
    for key in choice.options:
        if key not in known:
            near = get_close_matches(key, known, n=1)
            meant = f"did you mean {near[0]!r}? " if near else ""
            raise ConfigError(f"{where} has no parameter {key!r}", remedy=meant + allowed)
    for name, parameter in known.items():
        if parameter.default is parameter.empty and name not in choice.options:
            raise ConfigError(f"{where} lacks its parameter {name!r}", remedy=allowed)


def _check_needs(scene: Scene, name: str, effect: AnyEffect, before: Iterable[str]) -> None:
    on = {choice.name for choice in scene.effects}
    for need in effect.needs:
        if need not in on:
            raise ConfigError(
                f"scene {scene.name!r} has effect {name!r} without {need!r}",
                remedy=f'add [[effects]] name = "{need}" before it, or take {name!r} out',
            )
        if need not in before:
            raise ConfigError(
                f"scene {scene.name!r} has effect {name!r} before {need!r}, which it needs",
                remedy=f"move {need!r} above {name!r}",
            )
    for earlier in getattr(effect, "after", ()):
        if earlier in on and earlier not in before:
            raise ConfigError(
                f"scene {scene.name!r} has effect {name!r} before {earlier!r}, which it acts on",
                remedy=f"move {earlier!r} above {name!r}",
            )
