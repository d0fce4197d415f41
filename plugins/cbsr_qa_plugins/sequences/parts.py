"""Runs of steps that every built-in sequence is made of, and the kinds of options they have in common."""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from cbsr_qa.plugin import (
    LEAST_SPREAD_MM,
    AcquireFrames,
    Array,
    ConfigError,
    FindSurface,
    Hold,
    Load,
    LowerHover,
    MarkUnloaded,
    PluginOptions,
    Press,
    Release,
    SequenceContext,
    Settle,
    Step,
    TouchPlane,
    spread_mm,
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
#: Of a phase after the one that took those: they show what residues there are before its first press.
_FEW_FRAMES: Final = 4
#: Standard deviation of the image of a press [mm]: how much of a residue is seen at another place. Images of
#: simulated sheets at noise figure 1 have 12 mm at the centre and 8 mm near the edge.
IMAGE_SPREAD_MM: Final = 11.0


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
Clearance = Annotated[float, Field(gt=0, le=100)] | None
Drift = Annotated[float, Field(ge=0.05, le=10)] | None
Touches = Annotated[tuple[Annotated[tuple[Coordinate, Coordinate], Array], ...], Array, Field(min_length=3)]
Name = Annotated[str, AfterValidator(_name)]
Rising = AfterValidator(_rising)


class RestedOptions(PluginOptions):
    """What comes before the first press of most sequences."""

    initial_rest_s: Rest = 240.0
    find_surface: bool = True
    unloaded_frames: Frames = UNLOADED_FRAMES


class ClearOptions(RestedOptions):
    """Travel just clear of the sheet."""

    unloaded_before: bool = False
    clearance_mm: Clearance = None


class BriefOptions(ClearOptions):
    """Rests that end by the predicted residue, besides."""

    residue_percent: Annotated[float, Field(ge=0.01, le=100)] | None = None
    least_rest_s: Rest = 5.0


class SurfaceOptions(ClearOptions):
    """The surface as a plane, and a first rest that ends when readings are stable, besides."""

    surface: Literal["each", "plane"] = "each"
    touches_mm: Touches = ()
    surface_tolerance_mm: Annotated[float, Field(ge=0.01, le=1)] = 0.1
    drift: Drift = None
    least_initial_rest_s: Rest = 30.0


class QuickOptions(BriefOptions, SurfaceOptions):
    """All that may take less time per press."""


def prepare_sheet(options: RestedOptions, places_mm: Iterable[tuple[float, float]]) -> Iterator[Step]:
    """Find the surfaces if requested, let the sheet rest, and take the unloaded frames.

    Without unloaded frames the rest before the first press takes frames.
    """
    clear = options if isinstance(options, ClearOptions) else ClearOptions()
    surface = options if isinstance(options, SurfaceOptions) else SurfaceOptions()
    if clear.clearance_mm is not None:
        yield LowerHover(clear.clearance_mm)
    if options.find_surface and surface.surface == "plane":
        yield from touch_plane(surface.touches_mm or spread_touches(list(places_mm)), surface.surface_tolerance_mm)
    elif options.find_surface:
        yield from find_surfaces(places_mm)
    if options.unloaded_frames:
        frames = _FEW_FRAMES if clear.unloaded_before else options.unloaded_frames
        yield from take_unloaded_frames(options.initial_rest_s, frames, surface.drift, surface.least_initial_rest_s)
    elif options.initial_rest_s:
        yield Hold(options.initial_rest_s, acquire=True)


def touch_plane(places_mm: Sequence[tuple[float, float]], tolerance_mm: float) -> Iterator[Step]:
    """Touch the sheet at the places of a plane.

    Raises
    ------
    ConfigError
        If they are fewer than three, or nearly in a line.
    """
    if spread_mm(places_mm) < LEAST_SPREAD_MM:
        raise ConfigError(
            f'surface = "plane": the places touched lie less than {LEAST_SPREAD_MM:g} mm from a line',
            remedy='give touches_mm three places farther from a line, or use surface = "each"',
        )
    for x_mm, y_mm in places_mm:
        yield TouchPlane(x_mm, y_mm, tolerance_mm)


def spread_touches(places_mm: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Choose the three of a phase's places that lie farthest from a line, in the order of the phase; fewer if few."""
    triples = combinations(_hull(list(dict.fromkeys(places_mm))), 3)
    farthest = max(triples, key=spread_mm, default=())
    return tuple(place for place in dict.fromkeys(places_mm) if place in farthest)


def _hull(places_mm: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The places farthest out in twelve directions: the widest triangle has its corners far out."""
    angles = [2 * math.pi * k / 12 for k in range(12)]
    farthest = (max(places_mm, key=lambda p: p[0] * math.cos(a) + p[1] * math.sin(a)) for a in angles)
    return list(dict.fromkeys(farthest)) if places_mm else []


def find_surfaces(places_mm: Iterable[tuple[float, float]]) -> Iterator[Step]:
    """Find the surface at each different place, in the order they first occur."""
    for x_mm, y_mm in dict.fromkeys(places_mm):
        yield FindSurface(x_mm, y_mm)


def take_unloaded_frames(
    rest_s: float, frames: int, drift: float | None = None, least_s: float = 0.0
) -> Iterator[Step]:
    """Let the sheet rest, then take the frames that noise floor and reference come from.

    A rest of fixed length takes no frames: nothing is drawn from them, and they would only fill the store.

    Parameters
    ----------
    drift, least_s : of the rest that ends when readings drift no more (``Settle``); None for one of fixed length.
    """
    if rest_s > 0 and drift is not None:
        yield Settle(rest_s, acquire=True, least_s=min(least_s, rest_s), drift=drift)
    elif rest_s > 0:
        yield Hold(rest_s, acquire=False)
    yield MarkUnloaded()
    yield AcquireFrames(frames)


def presses(
    options: RestedOptions, loads: Sequence[Load], *, hold_s: float, rest_s: float, context: SequenceContext
) -> Iterator[Step]:
    """Prepare the sheet, then press all loads, one cycle each."""
    yield from prepare_sheet(options, ((load.x_mm, load.y_mm) for load in loads))
    rests_s = [rest_s] * len(loads)
    if isinstance(options, BriefOptions) and options.residue_percent is not None:
        share = options.residue_percent / 100
        rests_s = plan_rests_s(
            loads, context, share=share, hold_s=hold_s, least_s=min(options.least_rest_s, rest_s), most_s=rest_s
        )
    for load, seconds in zip(loads, rests_s, strict=True):
        yield from press_cycle(load, hold_s=hold_s, rest_s=seconds)


def plan_rests_s(
    loads: Sequence[Load], context: SequenceContext, *, share: float, hold_s: float, least_s: float, most_s: float
) -> list[float]:
    """Rests after each load, until the predicted residue at the next place is below a share of its change [s].

    The residue of a load is its strain times Σ |w| e^(−t/τ) of the material's unloading relaxation, and less by
    e^(−d²/2s²) at a distance d from it, with s of :data:`IMAGE_SPREAD_MM`; residues of earlier loads add up. Time is
    that of holds and rests, which is less than really passes. The last load rests longest, as what follows is not
    known.

    Raises
    ------
    ConfigError
        If the material is not known.
    """
    if context.material is None:
        raise ConfigError("residue_percent needs the material's relaxation, which is not known here")
    rests_s: list[float] = []
    for number, following in enumerate(loads[1:]):
        released = loads[: number + 1]
        # Time from each release to the beginning of this rest.
        since_s = [sum(hold_s + rest for rest in rests_s[k:number]) for k in range(number + 1)]
        rests_s.append(_rest_s(released, since_s, following, context, share, least_s, most_s))
    return [*rests_s, most_s][: len(loads)]


def _rest_s(
    released: Sequence[Load],
    since_s: Sequence[float],
    following: Load,
    context: SequenceContext,
    share: float,
    least_s: float,
    most_s: float,
) -> float:
    """Shortest rest in whole seconds beyond the least one; the longest if the residue is too large even then."""
    seconds = least_s
    while seconds < most_s:
        ages_s = [age_s + seconds for age_s in since_s]
        if predict_residue(released, ages_s, following, context) <= share * following.strain:
            return seconds
        seconds += 1.0
    return most_s


def predict_residue(
    released: Sequence[Load], ages_s: Sequence[float], following: Load, context: SequenceContext
) -> float:
    """Residue of released loads at the place of another, in units of the steady change per strain.

    Parameters
    ----------
    ages_s : time since each load was released.
    """
    assert context.material is not None
    relaxation = context.material.unloading_relaxation
    terms = list(zip(relaxation.weights, relaxation.time_constants_s, strict=True))
    total = 0.0
    for load, age_s in zip(released, ages_s, strict=True):
        left = sum(abs(weight) * math.exp(-age_s / tau) for weight, tau in terms)
        distance_mm = math.dist((load.x_mm, load.y_mm), (following.x_mm, following.y_mm))
        total += load.strain * left * math.exp(-(distance_mm**2) / (2 * IMAGE_SPREAD_MM**2))
    return total


def press_cycle(load: Load, *, hold_s: float, rest_s: float) -> Iterator[Step]:
    """Press, hold, release and rest, taking frames through hold and rest (paper: 60 s on, 60 s off)."""
    yield Press(load)
    yield Hold(hold_s, acquire=True)
    yield Release()
    if rest_s > 0:
        yield Hold(rest_s, acquire=True)
