"""Results of checks, and wording of failures."""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.imaging import LinearReconstruction, PreparedReconstruction
from cbsr_qa.domain.numbers import Array


@dataclass(frozen=True, slots=True)
class Checked:
    """Result of one check.

    Parameters
    ----------
    check : its name.
    found : the figure that was compared, in words; or why the check does not apply.
    applies : False if not made.
    """

    check: str
    found: str
    applies: bool = True


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Allowed errors of a method. A method that needs more states it in its check.

    Parameters
    ----------
    place : distance of a blob's centre from the target's, of the sheet's radius.
    masked_place : the same with three electrodes masked.
    linearity : relative departure of images from linearity, if claimed.
    turned_image : relative difference between the turned image and the image of the turned target, on a mesh that is
        exactly symmetric. Methods that see the problem's own numbers alone reach rounding.
    turned_place : distance of the two blobs' centres, of the sheet's radius.
    threads : relative difference between images of processes with one and two threads.
    """

    place: float = 0.1
    masked_place: float = 0.15
    linearity: float = 1e-9
    turned_image: float = 1e-6
    turned_place: float = 1e-6
    threads: float = 1e-8


COMMON = Tolerances()


def is_linear(prepared: PreparedReconstruction) -> bool:
    """Whether a method claims that its images of a block of frames are linear in the block."""
    return isinstance(prepared, LinearReconstruction) or bool(getattr(prepared, "linear", False))


def relative(a: Array, b: Array) -> float:
    """Distance in the largest norm, relative to the larger of the two."""
    scale = max(float(np.abs(a).max()), float(np.abs(b).max()))
    return float(np.abs(a - b).max()) / scale if scale else 0.0


def demand(subject: object, holds: bool, otherwise: str) -> None:
    """Raise AssertionError naming the method or driver and what it did, unless a promise holds."""
    if not holds:
        raise AssertionError(describe_failure(subject, otherwise))


def describe_failure(subject: object, what: str) -> str:
    """Describe a failure of a method (by its name) or a driver (by its type)."""
    return f"{getattr(subject, 'method', '') or type(subject).__name__} {what}"
