"""Steps a sequence asks for. The runner executes them; a dry run only counts them."""

from dataclasses import dataclass
from enum import StrEnum

from cbsr_qa.domain.loads import Load


class Role(StrEnum):
    """What a sequence is for: metrics and report sections look for roles, never for a plugin's name."""

    NOISE = "noise"  #: unloaded frames and centre loads for the noise figure
    GRID = "grid"  #: fixed places at common strains
    RANDOM = "random"  #: places and strains drawn at random
    RELAXATION = "relaxation"  #: long holds for relaxation fits
    PRECONDITIONING = "preconditioning"  #: presses that work the sheet in before anything is measured
    CHARACTERISATION = "characterisation"  #: press cycles on a strip of the material
    LOOP = "loop"  #: strains reached from below and from above without lifting the head between
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class Home:
    """Find the applicator's zero."""


@dataclass(frozen=True, slots=True)
class FindSurface:
    """Step down at a place until the contact force, and remember the zero-strain height there."""

    x_mm: float
    y_mm: float


@dataclass(frozen=True, slots=True)
class Press:
    """Travel to a load's place and press to its strain, at the press speed."""

    load: Load


@dataclass(frozen=True, slots=True)
class Ease:
    """Bring the pressed head to another strain at the same place, deeper or less deep, without leaving the sheet.

    At the press speed. A press that is eased is one load: it is stored, and done again after an interruption, as a
    whole.

    Parameters
    ----------
    strain : compressive, as a fraction; above 0.
    """

    strain: float


@dataclass(frozen=True, slots=True)
class Hold:
    """Stay for a while, pressed or not.

    Parameters
    ----------
    hold_s : how long [s].
    acquire : whether frames are taken all the while.
    """

    hold_s: float
    acquire: bool


@dataclass(frozen=True, slots=True)
class Release:
    """Lift the head to the hover height."""


@dataclass(frozen=True, slots=True)
class AcquireFrames:
    """Take a number of frames."""

    count: int


@dataclass(frozen=True, slots=True)
class MarkUnloaded:
    """Say that the sheet has rested: frames from here to the next press are reference and noise."""


@dataclass(frozen=True, slots=True)
class Prompt:
    """Ask the operator to do something and wait for the answer."""

    text: str


Step = Home | FindSurface | Press | Ease | Hold | Release | AcquireFrames | MarkUnloaded | Prompt
