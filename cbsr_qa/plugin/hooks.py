"""The plugin author's manual: the hooks, when each is called, in what order, and what None means.

A distribution joins by one entry point in the group ``cbsr_qa`` that names a module with these hooks.
The built-ins (``cbsr_qa_plugins.registry``) enter by the same door.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pluggy

if TYPE_CHECKING:  # plugins are listed without numpy
    from cbsr_qa.domain.results.calibration import Calibration
    from cbsr_qa.domain.run.run import RunIdentity
    from cbsr_qa.domain.sensor.sensor_type import SensorIdentity

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

    Parameters
    ----------
    register : called once for each plugin, with its kind, its name and where its factory is.
    """


@dataclass(frozen=True, slots=True)
class Example:
    """How ``cbsr-qa plugins check`` and the kit try a plugin.

    Parameters
    ----------
    options : of the plugin, as in a recipe, scene or station file. Of an instrument: the address of its emulator.
    file : of a recording format: a file that it reads.
    received : of a sink: returns the messages that have arrived so far, in order.
    tolerances : of a reconstruction that needs other ones than usual, by field of ``Tolerances``.
    close : called after the checks, e.g. to stop an emulator.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    file: Path | None = None
    received: Callable[[], Sequence[Mapping[str, Any]]] | None = None
    tolerances: Mapping[str, float] = field(default_factory=dict)
    close: Callable[[], None] = lambda: None


@hookspec
def cbsr_example(kind: Kind, name: str) -> Example | None:
    """Say how a plugin of this distribution is tried; called by ``cbsr-qa plugins check`` and the kit alone.

    None tries it with its default options; an instrument is then not opened, because it could be a real one.

    Parameters
    ----------
    kind, name : of the plugin, as registered.
    """


@dataclass(frozen=True, slots=True)
class Emulator:
    """What stands for an instrument whose address in the station file is ``"emulated"``.

    Parameters
    ----------
    make : called with the ``EmulatedRig`` (clock and simulated sheet of the station), the instrument's options, and a
        function that sends bytes unasked. Returns a ``Served``: ``receive(data)`` returns the answers.
    network : whether it is reached over a TCP socket, as a VISA resource; otherwise over a serial line.
    """

    make: Callable[[Any, Mapping[str, Any], Callable[[bytes], None]], Any]
    network: bool = False


@hookspec
def cbsr_emulator(driver: str) -> Emulator | None:
    """Say what emulates the instruments of a driver of this distribution.

    Called for stations that emulate such an instrument. None: it has no emulator.

    Parameters
    ----------
    driver : name of the driver, as registered.
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
def cbsr_before_run(sensor: "SensorIdentity", station: str, recipe: str, operator: str) -> Veto | None:
    """A run is about to begin: files and names are checked, no instrument is open, nothing is stored.

    None lets it begin; a :class:`Veto` is handled by the policy ``before_run`` of the station file
    (docs/reference/gate.md), and so is an exception, another return value, or no answer within ``before_run_s``. All
    implementations are called, each in a thread of its own. It is called for ``cbsr-qa gate`` and for a dry run too,
    so it must only look. It is not called when a run is resumed.

    Parameters
    ----------
    sensor : serial number, batch and type.
    station, recipe : their names.
    operator : empty if not stated.
    """


@hookspec
def cbsr_run_started(identity: "RunIdentity") -> None:
    """A run begins: its instruments are open and have said who they are, nothing has moved yet.

    All implementations are called; None is expected. An exception is reported as a warning of the run; it stops
    nothing and no other implementation; only ``AbortedError(by)`` stops the run cleanly and says by whom. The same
    holds for the hook below.

    Parameters
    ----------
    identity : of the run: sensor, station, recipe, instruments.
    """


@hookspec
def cbsr_phase_finished(identity: "RunIdentity", phase: str) -> None:
    """A phase has ended and all its frames are stored. All implementations are called; None is expected.

    Parameters
    ----------
    identity : of the run.
    phase : its name in the recipe.
    """


@hookspec
def cbsr_calibration_issued(calibration: "Calibration") -> None:
    """A calibration was stored and its file written.

    All implementations are called; None is expected. An exception is reported as a warning.

    Parameters
    ----------
    calibration : as in the file.
    """
