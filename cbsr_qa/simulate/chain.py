"""The effects of a scene as an ordered list of callables; a disabled effect is absent."""

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

import numpy as np

from cbsr_qa.domain.errors import CbsrError, ConfigError, PluginError
from cbsr_qa.domain.plan.plan import PluginChoice, Scene
from cbsr_qa.domain.plan.world import Moment, SceneSetting, SheetDesign, Transcript
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa.plugin.failures import failure
from cbsr_qa.plugin.interfaces import AnyEffect, Effect, RecordingEffect, SheetEffect, SwitchingEffect
from cbsr_qa.plugin.options import options_of
from cbsr_qa.system.copies import end_copy, end_forked_copies
from cbsr_qa.system.words import quote_value

#: ``effect_factory(name)`` returns the factory of an effect: ``factory(setting, **parameters)``.
EffectFactory = Callable[[str], Callable[..., Any]]

#: Quantities that an effect may perturb, in the order of evaluation.
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

#: Stages whose effects have their own method instead of ``apply``: the method, and what has it.
_OWN_METHODS: Final[Mapping[str, tuple[str, type]]] = {
    "sheet": ("design(design)", SheetEffect),
    "recording": ("record(transcript)", RecordingEffect),
}

#: Attributes of a moment that the effects of a stage change, and must leave finite.
_CHANGED: Final[Mapping[str, tuple[str, ...]]] = {
    "position": ("place_mm", "depth_mm"),
    "geometry": ("surface_mm",),
    "times": ("reading_offsets_s",),
    "response": ("response",),
    "stress": ("stress_kPa",),
    "contacts": ("contact_mm",),
    "impedance": ("impedance_ohm",),
    "source": ("current_A",),
    "voltages": ("voltages",),
    "force": ("force_N",),
}


class Chain:
    """The enabled effects by stage, each stage in the scene's order."""

    def __init__(self, effects: Iterable[tuple[str, AnyEffect]]) -> None:
        named_effects = tuple(effects)
        self.names = tuple(name for name, _ in named_effects)
        self._sheet = tuple((name, e) for name, e in named_effects if isinstance(e, SheetEffect))
        self._recording = tuple((name, e) for name, e in named_effects if isinstance(e, RecordingEffect))
        self._stages = {
            stage: tuple(
                (name, e)
                for name, e in named_effects
                if e.perturbs == stage and stage not in _OWN_METHODS and isinstance(e, Effect)
            )
            for stage in STAGES
        }

    def has(self, stage: str) -> bool:
        return bool(self._stages[stage])

    @property
    def memory_s(self) -> float:
        """How long a press affects the response [s]; infinite if an effect does not limit it."""
        return max((getattr(effect, "memory_s", math.inf) for _, effect in self._stages["response"]), default=0.0)

    def design(self, design: SheetDesign) -> None:
        """Apply the effects of the stage ``sheet`` to a sheet's design."""
        for name, effect in self._sheet:
            with _blame_effect(name):
                effect.design(design)

    def record(self, transcript: Transcript) -> None:
        """Apply the effects of the stage ``recording`` to the transcript."""
        for name, effect in self._recording:
            with _blame_effect(name):
                effect.record(transcript)

    def apply(self, stage: str, moment: Moment) -> None:
        """Apply the effects of a stage to a moment, in order.

        PluginError if one fails, or leaves a value that is not finite.
        """
        process = os.getpid()
        for name, effect in self._stages[stage]:
            try:  # not _blame_effect: this is the most frequent call
                effect.apply(moment)
                finite = _is_finite(stage, moment)
            except CbsrError:
                raise
            except BaseException as error:
                raise _effect_error(name, error, f" at {moment.time_s:.6g} s") from error
            finally:
                end_copy(process)
            if not finite:
                problem = f"effect {name!r} leaves {' or '.join(_CHANGED[stage])} with non-finite values"
                raise PluginError(f"{problem} at {moment.time_s:.6g} s", remedy="give it smaller parameters")

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        """Times after the first and up to the last [s] at which the impedance jumps."""
        times_s: list[float] = []
        for name, effect in self._stages["impedance"]:
            if isinstance(effect, SwitchingEffect):
                with _blame_effect(name):
                    times_s += effect.switches(moment, first_s, last_s)
        return times_s


def _is_finite(stage: str, moment: Moment) -> bool:
    for attribute in _CHANGED[stage]:
        value = getattr(moment, attribute)
        if attribute == "voltages" and value is not None and moment.flags is not None:
            value = value[(moment.flags & ReadingFlag.MISSING.value) == 0]
        if value is None:
            continue
        if isinstance(value, np.ndarray):
            is_finite = bool(np.isfinite(value).all())
        else:
            is_finite = all(map(math.isfinite, value if isinstance(value, list | tuple) else (value,)))
        if not is_finite:
            return False
    return True


@contextmanager
def _blame_effect(name: str) -> Iterator[None]:
    try:
        with end_forked_copies():
            yield
    except CbsrError:
        raise
    except BaseException as error:
        raise _effect_error(name, error) from error


def _effect_error(name: str, error: BaseException, when: str = "") -> PluginError:
    return PluginError(
        f"effect {name!r} failed{when}: {failure(error)}",
        remedy="report it to its author, or remove it from the scene",
    )


def build_chain(scene: Scene, setting: SceneSetting, effect_factory: EffectFactory) -> Chain:
    """Create a scene's effects, in its order.

    ConfigError if an effect is enabled twice, comes before (or without) one that it needs, comes before one that it
    acts ``after``, perturbs nothing known, or gets an unknown parameter; PluginError if it does not exist (raised by
    ``effect_factory``). ``effect_factory``: finds an effect's factory by name; called for enabled effects only.
    """
    effects_by_name: dict[str, AnyEffect] = {}
    for choice in scene.effects:
        if choice.name in effects_by_name:
            raise ConfigError(f"scene {scene.name!r} lists effect {choice.name!r} twice", remedy="remove one of them")
        effect = _make(scene.name, choice, setting, effect_factory(choice.name))
        _check_needs(scene, choice.name, effect, effects_by_name)
        effects_by_name[choice.name] = effect
    return Chain(effects_by_name.items())


def _make(scene: str, choice: PluginChoice, setting: SceneSetting, factory: Callable[..., Any]) -> AnyEffect:
    try:
        options_of(factory, handed=1).read(choice.options)
        with end_forked_copies():
            effect: AnyEffect = factory(setting, **choice.options)
    except CbsrError as error:
        raise ConfigError(f"scene {scene!r}, effect {choice.name!r}: {error.reason}", remedy=error.remedy) from error
    except BaseException as error:
        reason = str(error) if isinstance(error, TypeError | ValueError) else failure(error)
        raise ConfigError(f"scene {scene!r}, effect {choice.name!r} cannot be created: {reason}") from error
    _check_names(choice.name, effect)
    if effect.perturbs not in STAGES:
        raise ConfigError(
            f"effect {choice.name!r} perturbs {effect.perturbs!r}",
            remedy=f"allowed: {', '.join(STAGES)}",
        )
    method, protocol = _OWN_METHODS.get(effect.perturbs, ("apply(moment)", Effect))
    if not isinstance(effect, protocol):
        raise ConfigError(
            f"effect {choice.name!r} perturbs {effect.perturbs!r} but lacks the method for it",
            remedy=f"add {method}",
        )
    return effect


def _check_names(name: str, effect: Any) -> None:
    """Refuse an effect whose `perturbs`, `needs` or `after` are not text."""
    perturbs = getattr(effect, "perturbs", None)
    if not isinstance(perturbs, str):
        raise ConfigError(
            f"effect {name!r} names no stage: perturbs = {quote_value(perturbs)}",
            remedy=f"allowed: {', '.join(STAGES)}",
        )
    for attribute, names in (("needs", getattr(effect, "needs", None)), ("after", getattr(effect, "after", ()))):
        if not isinstance(names, tuple | list) or not all(isinstance(effect_name, str) for effect_name in names):
            raise ConfigError(
                f"effect {name!r} has {attribute} = {quote_value(names)}", remedy="it must be a tuple of effect names"
            )


def _check_needs(scene: Scene, name: str, effect: AnyEffect, before: Iterable[str]) -> None:
    active_names = {choice.name for choice in scene.effects}
    for need in effect.needs:
        if need not in active_names:
            raise ConfigError(
                f"scene {scene.name!r} uses effect {name!r} without {need!r}",
                remedy=f'add [[effects]] name = "{need}" before it, or remove {name!r}',
            )
        if need not in before:
            raise ConfigError(
                f"scene {scene.name!r} lists effect {name!r} before {need!r}, which it needs",
                remedy=f"move {need!r} above {name!r}",
            )
    for earlier in getattr(effect, "after", ()):
        if earlier in active_names and earlier not in before:
            raise ConfigError(
                f"scene {scene.name!r} lists effect {name!r} before {earlier!r}, which it acts on",
                remedy=f"move {earlier!r} above {name!r}",
            )


#: Omissions of every scene, in words; docs/explanation/simulation.md lists the omissions of each effect.
NOT_MODELLED: Final[tuple[str, ...]] = (
    "the third dimension of the sheet, and heating by the current",
    "capacitance: currents are direct",
    "conductance that depends on direction; steps, holes and cracks of the sheet",
    "a sheet that is bent, or that moves while it is pressed",
    "ageing of the material, and relaxation that depends on strain",
    "contacts that feel the head, or depend on the current",
    "stress that one load causes under another; slip under a head",
    "acceleration of the head; compliance and vibration of the frame",
    "drift, hysteresis and creep of the load cell",
    "noise that is correlated in time, and steps in noise",
)
