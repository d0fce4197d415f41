"""Runs of steps that every built-in sequence is made of, and the kinds of options they have in common."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Any, Final

from pydantic import AfterValidator, BeforeValidator, Field

from cbsr_qa.plugin import (
    AcquireFrames,
    Array,
    FindSurface,
    Hold,
    Load,
    MarkUnloaded,
    PluginOptions,
    Press,
    Release,
    Step,
)

#: Lowest strain any sequence may request [%]: 0.04 mm of a 4 mm sheet, less than one step of 0.05 mm in which the
#: head feels for the surface. A lower value is a fraction written instead of per cent.
STRAIN_FLOOR_PERCENT: Final = 1.0
#: Highest strain any sequence may request [%]; what the station allows is checked by the runner besides.
STRAIN_CEILING_PERCENT: Final = 60.0
#: Longest single hold or rest [s].
LONGEST_S: Final = 86400.0
#: Unloaded frames before the first press: eight for the noise floor and eight others for the reference.
UNLOADED_FRAMES: Final = 16


def _check_percent(value: Any) -> Any:
    if isinstance(value, float) and 0 < value < STRAIN_FLOOR_PERCENT:
        allowed = f"a number from {STRAIN_FLOOR_PERCENT:g} to {STRAIN_CEILING_PERCENT:g}, in per cent"
        raise ValueError(f"it must be {allowed}: write {100 * value:g} for the fraction {value:g}")
    return value


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("it must be a pair [lowest, highest] with the lower one first")
    return pair


def _name(text: str) -> str:
    if not text.strip():
        raise ValueError("it must be a name")
    return text


def once(repeated_by: str) -> AfterValidator:
    """Refuse a list that says the same thing twice: repeats are what another option is for."""

    def check_distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(set(values)) != len(values):
            raise ValueError(f"it must hold each entry once ({repeated_by} repeats them)")
        return values

    return AfterValidator(check_distinct)


Rest = Annotated[float, Field(ge=0, le=LONGEST_S)]
#: Of a press: frames after the steady state must exist.
Held = Annotated[float, Field(ge=1, le=LONGEST_S)]
Times = Annotated[int, Field(ge=1, le=1000)]
Frames = Annotated[int, Field(ge=UNLOADED_FRAMES, le=100_000)]
Coordinate = Annotated[float, Field(ge=-1e3, le=1e3)]
Strain = Annotated[float, Field(ge=STRAIN_FLOOR_PERCENT, le=STRAIN_CEILING_PERCENT), BeforeValidator(_check_percent)]
Strains = Annotated[tuple[Strain, ...], Array, Field(min_length=1)]
Places = Annotated[tuple[Annotated[tuple[Coordinate, Coordinate], Array], ...], Array, Field(min_length=1)]
Name = Annotated[str, AfterValidator(_name)]
Rising = AfterValidator(_rising)


class RestedOptions(PluginOptions):
    """What comes before the first press of most sequences."""

    initial_rest_s: Rest = 240.0
    find_surface: bool = True
    unloaded_frames: Frames = UNLOADED_FRAMES


def prepare_sheet(options: RestedOptions, places_mm: Iterable[tuple[float, float]]) -> Iterator[Step]:
    """Find the surfaces if requested, let the sheet rest, and take the unloaded frames."""
    if options.find_surface:
        yield from find_surfaces(places_mm)
    yield from take_unloaded_frames(options.initial_rest_s, options.unloaded_frames)


def find_surfaces(places_mm: Iterable[tuple[float, float]]) -> Iterator[Step]:
    """Find the surface at each different place, in the order they first occur."""
    for x_mm, y_mm in dict.fromkeys(places_mm):
        yield FindSurface(x_mm, y_mm)


def take_unloaded_frames(rest_s: float, frames: int) -> Iterator[Step]:
    """Let the sheet rest, then take the frames that noise floor and reference come from.

    The rest itself takes no frames: nothing is drawn from them, and they would only fill the store.
    """
    if rest_s > 0:
        yield Hold(rest_s, acquire=False)
    yield MarkUnloaded()
    yield AcquireFrames(frames)


def presses(options: RestedOptions, loads: Sequence[Load], *, hold_s: float, rest_s: float) -> Iterator[Step]:
    """Prepare the sheet, then press all loads, one cycle each."""
    yield from prepare_sheet(options, ((load.x_mm, load.y_mm) for load in loads))
    for load in loads:
        yield from press_cycle(load, hold_s=hold_s, rest_s=rest_s)


def press_cycle(load: Load, *, hold_s: float, rest_s: float) -> Iterator[Step]:
    """Press, hold, release and rest, taking frames through hold and rest (paper: 60 s on, 60 s off)."""
    yield Press(load)
    yield Hold(hold_s, acquire=True)
    yield Release()
    if rest_s > 0:
        yield Hold(rest_s, acquire=True)
