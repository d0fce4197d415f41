"""Up through some strains and down through the same, without lifting the head between.

Noise of the rested sheet, and the response to a centre load that its noise figure is taken from.

One long press and one long rest: how the sheet settles after loading and after unloading.

Presses that work the sheet in before anything is measured.
"""

from collections.abc import Iterator
from typing import Annotated

from pydantic import AfterValidator, Field

from cbsr_qa.plugin import (
    NINE_LOCATIONS_MM,
    Array,
    Hold,
    Load,
    LowerHover,
    PluginOptions,
    Press,
    Release,
    Role,
    SequenceContext,
    Step,
    StrainStep,
    WithOptions,
)
from cbsr_qa_plugins.sequences import parts


class NoiseFigureSequence(WithOptions):
    """A long rest, many unloaded frames, then the centre load L0 a few times.

    Parameters
    ----------
    rest_s : rest before the unloaded frames.
    frames : number of unloaded frames; noise floor and reference need separate ones.
    strain_percent : strain of the centre load.
    hold_s : time pressed; long enough to reach the steady state.
    trials : how often the press is repeated.
    recovery_s : rest after each press.
    find_surface : whether the centre's surface is found first.
    clearance_mm : travel height above the sheet; by default the hover height.
    drift : of readings, in noise of a frame, at which the rest ends.
    least_rest_s : shortest such rest.

    """

    class Options(PluginOptions):
        rest_s: parts.Rest = 240.0
        frames: parts.Frames = 30
        strain_percent: parts.Strain = 20.0
        hold_s: parts.Held = 60.0
        trials: parts.Times = 3
        recovery_s: parts.Rest = 60.0
        find_surface: bool = True
        clearance_mm: parts.Clearance = None
        drift: parts.Drift = None
        least_rest_s: parts.Rest = 30.0

    role = Role.NOISE
    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        options, (x_mm, y_mm) = self.options, NINE_LOCATIONS_MM[0]
        if options.clearance_mm is not None:
            yield LowerHover(options.clearance_mm)
        if options.find_surface:
            yield from parts.find_surfaces([(x_mm, y_mm)])
        yield from parts.take_unloaded_frames(options.rest_s, options.frames, options.drift, options.least_rest_s)
        for trial in range(options.trials):
            load = Load("L0", x_mm, y_mm, options.strain_percent / 100, trial)
            yield from parts.press_cycle(load, hold_s=options.hold_s, rest_s=options.recovery_s)


class RelaxationSequence(WithOptions):
    """A press held until the slow exponential has died out, and a rest of the same length.

    The load is labelled by its place: L0 … L8 on the paper's nine locations, X0 elsewhere.

    Parameters
    ----------
    x_mm, y_mm : place; default the centre.
    strain_percent : strain of each press.
    hold_s : time pressed.
    rest_s : rest after each press; 240 s of both are about five of the paper's longest
        settling times.
    trials : how often the press is repeated.
    initial_rest_s : rest after surface finding.
    find_surface : whether the surface is found first.
    unloaded_frames : number of unloaded frames before the first press.

    """

    class Options(parts.RestedOptions):
        x_mm: parts.Coordinate = 0.0
        y_mm: parts.Coordinate = 0.0
        strain_percent: parts.Strain = 20.0
        hold_s: parts.Held = 240.0
        rest_s: parts.Rest = 240.0
        trials: parts.Times = 1

    role = Role.RELAXATION
    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        options, place_mm = self.options, (self.options.x_mm, self.options.y_mm)
        strain = options.strain_percent / 100
        label = f"L{NINE_LOCATIONS_MM.index(place_mm)}" if place_mm in NINE_LOCATIONS_MM else "X0"
        loads = [Load(label, *place_mm, strain, trial) for trial in range(options.trials)]
        yield from parts.presses(options, loads, hold_s=options.hold_s, rest_s=options.rest_s, context=context)


class PreconditioningSequence(WithOptions):
    """Press and release each location a fixed number of times, one location after the other (Mullins 1969).

    Filled rubber is softer after its first deformations, and keeps what a given strain has done to it until it is
    strained further: the strain here should be the highest of the rest of the recipe. The number of cycles is fixed
    and is the number of trials of each location; the metric ``preconditioning-change`` says what the last one still
    changed. No frame of it is a reference: the phase after it rests and takes the unloaded frames, so it must not be
    the only phase of a recipe.

    Parameters
    ----------
    cycles : number of presses of each location.
    strain_percent : strain of each press; 30 is the paper's highest.
    hold_s : time pressed.
    rest_s : rest after each press.
    locations_mm : [x, y] each, labelled L0, L1, … in order.
    find_surface : whether the surface is found at every location first.

    """

    class Options(PluginOptions):
        cycles: Annotated[int, Field(ge=2, le=1000)] = 5
        strain_percent: parts.Strain = 30.0
        hold_s: parts.Held = 10.0
        rest_s: parts.Held = 10.0
        locations_mm: Annotated[parts.Places, parts.once("cycles")] = NINE_LOCATIONS_MM
        find_surface: bool = True

    role = Role.PRECONDITIONING
    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        options = self.options
        if options.find_surface:
            yield from parts.find_surfaces(options.locations_mm)
        for number, (x_mm, y_mm) in enumerate(options.locations_mm):
            for cycle in range(options.cycles):
                load = Load(f"L{number}", x_mm, y_mm, options.strain_percent / 100, cycle)
                yield from parts.press_cycle(load, hold_s=options.hold_s, rest_s=options.rest_s)


def _above_each_other(strains: tuple[float, ...]) -> tuple[float, ...]:
    if list(strains) != sorted(set(strains)):
        raise ValueError("it must have each strain above the one before; the way back is the same downwards")
    return strains


class HysteresisLoopSequence(WithOptions):
    """Press in loops: up through the strains and down again without lifting the head, then release and rest.

    Every strain is held equally long, on the way up and down, so that each reading is as old as its counterpart; the
    highest is held once. Cycles of a location follow each other. A loop is one load: it is the calibration cycle of
    ISA-37.1, and a run that was interrupted begins it anew.

    Parameters
    ----------
    strains_percent : rising. Include half of the highest strain, where most loops are
        widest.
    cycles : number of loops at each location; two or more show their scatter.
    hold_s : hold at each strain.
    rest_s : rest after each loop.
    locations_mm : [x, y] each, labelled H0, H1, … in order.
    label : prefix of the labels.
    initial_rest_s : rest after surface finding.
    find_surface : whether the surface is found at every location first.
    unloaded_frames : number of unloaded frames before the first press.

    """

    class Options(parts.RestedOptions):
        strains_percent: Annotated[
            tuple[parts.Strain, ...], Array, Field(min_length=2), AfterValidator(_above_each_other)
        ] = (7.5, 15.0, 22.5, 30.0)
        cycles: parts.Times = 3
        hold_s: parts.Held = 60.0
        rest_s: parts.Rest = 120.0
        locations_mm: Annotated[parts.Places, parts.once("cycles")] = ((0.0, 0.0),)
        label: parts.Name = "H"

    role = Role.LOOP
    options: Options

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        options = self.options
        yield from parts.prepare_sheet(options, options.locations_mm)
        strains = [percent / 100 for percent in options.strains_percent]
        for number, (x_mm, y_mm) in enumerate(options.locations_mm):
            for cycle in range(options.cycles):
                yield Press(Load(f"{options.label}{number}", x_mm, y_mm, strains[0], cycle))
                yield Hold(options.hold_s, acquire=True)
                for strain in (*strains[1:], *strains[-2::-1]):
                    yield StrainStep(strain)
                    yield Hold(options.hold_s, acquire=True)
                yield Release()
                if options.rest_s > 0:
                    yield Hold(options.rest_s, acquire=True)
