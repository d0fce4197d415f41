"""The plugin author's manual: the hooks, when each is called, in what order, and what None means.

A distribution joins by one entry point in the group ``cbsr_qa`` that names a module with these hooks.
The built-ins (``cbsr_qa_plugins.registry``) enter by the same door.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import pluggy

from cbsr_qa.domain.results import Calibration
from cbsr_qa.domain.run import RunIdentity
from cbsr_qa.domain.sensor import SensorIdentity

PROJECT: Final = "cbsr_qa"

hookspec: Final = pluggy.HookspecMarker(PROJECT)
hookimpl: Final = pluggy.HookimplMarker(PROJECT)


class Kind(StrEnum):
    """Kinds of things a plugin can add. The word in brackets is the Protocol its factory returns."""

    INSTRUMENT = "instrument"  #: called with a StationContext (Instrument and the roles it provides)
    SEQUENCE = "sequence"  #: called with the phase's options from the recipe (Sequence)
    RECONSTRUCTION = "reconstruction"  #: called with its options from the recipe (Reconstruction)
    METRIC = "metric"  #: called with its options from the recipe (LoadMetric, RunMetric or both)
    EFFECT = "effect"  #: called with its parameters from the scene and the SceneSetting (Effect)
    RECORDING = "recording"  #: called with nothing (RecordingFormat)
    SECTION = "section"  #: called with nothing (ReportSection)
    SINK = "sink"  #: called with its options from the station file (EventSink)


#: ``register(kind, name, "package.module:factory")``; names are lower case words joined by hyphens.
Register = Callable[[Kind, str, str], None]


@hookspec
def cbsr_register(register: Register) -> None:
    """Register what this plugin adds.

    Called once, when plugins are first needed (``--version`` needs none). Only names are given; the module
    behind one is imported when that name is used. Registering a name twice within a kind is refused, and the
    later plugin is listed as failed. The return value is ignored. An exception here lists the plugin as
    failed with its reason and takes nothing else down.
    """


@dataclass(frozen=True, slots=True)
class Veto:
    """A plugin's objection to a run.

    Parameters
    ----------
    name : of the system that objects, e.g. ``"routing"``.
    reason : as a clause, e.g. ``"order 4711 is on hold"``.
    remedy : what to do about it; may be empty.
    """

    name: str
    reason: str
    remedy: str = ""


@hookspec
def cbsr_before_run(sensor: SensorIdentity, station: str, recipe: str, operator: str) -> Veto | None:
    """A run is about to begin: files and names are checked, no instrument is open, nothing is stored.

    None lets it begin; a :class:`Veto` is handled by the policy ``before_run`` of the station file
    (docs/reference/gate.md), and so is an exception, another return value, or no answer within ``before_run_s``. All
    implementations are called, each in a thread of its own. It is called for ``cbsr-qa gate`` and for a dry run too,
    so it must only look. It is not called when a run is resumed.
    """


@hookspec
def cbsr_run_started(identity: RunIdentity) -> None:
    """A run begins: its instruments are open and have said who they are, nothing has moved yet.

    All implementations are called; None is expected. An exception is reported as a warning of the run; it stops
    nothing and no other implementation; only ``AbortedError(by)`` stops the run in order and says by whom. The same
    holds for the hook below.
    """


@hookspec
def cbsr_phase_finished(identity: RunIdentity, phase: str) -> None:
    """A phase has ended and all its frames are stored. All implementations are called; None is expected."""


@hookspec
def cbsr_calibration_issued(calibration: Calibration) -> None:
    """A calibration was stored and its file written.

    All implementations are called; None is expected. An exception is reported as a warning.
    """
