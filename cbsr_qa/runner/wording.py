"""Steps in words, for people who watch, wait or look for what went wrong."""

from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.steps import (
    AcquireFrames,
    Ease,
    FindSurface,
    Hold,
    Home,
    MarkUnloaded,
    Press,
    Prompt,
    Release,
    Step,
)


def describe(step: Step) -> str:
    """Say what a step does; a step of a type nobody knows is called by its type."""
    said = f"an unknown step ({type(step).__name__})"
    match step:
        case Home():
            said = "homing"
        case FindSurface(x_mm=x_mm, y_mm=y_mm):
            said = f"finding the surface at ({x_mm:g}, {y_mm:g}) mm"
        case Press(load=load):
            said = f"pressing {describe_load(load)}"
        case Ease(strain=strain):
            said = f"easing to {100 * strain:g} %"
        case Hold(hold_s=hold_s, acquire=acquire):
            said = f"holding still for {hold_s:g} s{', taking frames' if acquire else ''}"
        case Release():
            said = "releasing"
        case AcquireFrames(count=count):
            said = f"taking {count} frames"
        case MarkUnloaded():
            said = "calling the sheet rested"
        case Prompt(text=text):
            said = f"asking: {text}"
    return said


def describe_load(load: Load) -> str:
    """Say which load this is."""
    trial = f", trial {load.trial + 1}" if load.trial else ""
    return f"{load.label} at ({load.x_mm:g}, {load.y_mm:g}) mm to {100 * load.strain:g} %{trial}"


def duration(seconds: float) -> str:
    """Say a duration as a person would: ``"40 s"``, ``"18 min"``, ``"5.4 h"``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
