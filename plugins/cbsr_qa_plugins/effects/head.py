"""Effects of the head: its edge and pressure, where it gets to, and how the sheet lies under it.

Electrodes that are not quite where they should be are here too: what counts is where they are from the head.
"""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cbsr_qa.plugin import ConfigError, HeadRing, Indenter, Moment, PluginOptions, SceneSetting, SheetDesign
from cbsr_qa.simulate.effect import Amount, Positive, SceneEffect, check_at_most
from cbsr_qa.simulate.streams import RandomStream
from cbsr_qa_plugins.effects.sheet import draw_field

_ROUNDING = 1e-9  # of the square of the head's reach


def check_nested(indenter: Indenter) -> None:
    """Refuse a head whose smaller outlines do not lie within larger ones: its axis does not see it whole."""
    if not indenter.outline_mm:
        return
    corners = np.array(indenter.outline_mm)
    x_mm, y_mm = corners.T
    next_x_mm, next_y_mm = np.roll(corners, -1, axis=0).T
    seen_mm2 = x_mm * next_y_mm - y_mm * next_x_mm  # twice the area that an edge spans with the axis
    worst = int(seen_mm2.argmin())
    if seen_mm2[worst] < -_ROUNDING * indenter.reach_mm**2:
        raise ConfigError(
            f"the head's edge after its corner ({x_mm[worst]:g}, {y_mm[worst]:g}) mm is seen from behind by its axis:"
            " smaller outlines of its shape do not lie within larger ones",
            remedy="take an axis from which straight lines to all of the outline lie within the head",
        )


_RINGS = 8


class HeadEdge(SceneEffect):
    """The strain falls linearly to zero over a band about the head's edge; the total is kept.

    Made of eight nested heads of equal weight, whose sizes are the midpoints of eight parts of the band. The band of
    a head that is not round has this width where its edge is as far from the axis as that of the disc of equal area.

    Parameters
    ----------
    width_mm : width of the band.
    """

    class Options(PluginOptions):
        width_mm: Amount

    perturbs = "sheet"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        check_nested(setting.indenter)
        radius_mm = setting.indenter.radius_mm
        check_at_most("width_mm", self.options.width_mm, 1.9 * radius_mm, "the head is no wider")
        self._share = self.options.width_mm / radius_mm

    def design(self, design: SheetDesign) -> None:
        sizes = 1 + self._share * ((np.arange(_RINGS) + 0.5) / _RINGS - 0.5)
        weight = 1 / float((sizes**2).sum())
        design.rings = tuple(
            HeadRing(ring.size * float(size), ring.weight * weight) for ring in design.rings for size in sizes
        )


_RINGS_PRESSURE_PROFILE = 10


class PressureProfile(SceneEffect):
    """The response follows a pressure that depends on the distance from the head's axis.

    1 on average. ``punch``: p = ½ (1 − ρ²)^(−½), a rigid punch on an elastic half-space (Boussinesq);
    ``parabola``: p = 2 (1 − ρ²), a domed one. In ten annuli of equal width with the exact mean pressure of each.

    Parameters
    ----------
    shape : pressure profile.
    """

    class Options(PluginOptions):
        shape: Literal["punch", "parabola"]

    perturbs = "sheet"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        check_nested(setting.indenter)

    def design(self, design: SheetDesign) -> None:
        edges = np.linspace(0, 1, _RINGS_PRESSURE_PROFILE + 1)
        inside = 1 - np.sqrt(1 - edges**2) if self.options.shape == "punch" else 2 * edges**2 - edges**4
        pressure = np.diff(inside) / np.diff(edges**2)
        weights = pressure - np.append(pressure[1:], 0.0)  # of whole heads: each holds all within it
        design.rings = tuple(
            HeadRing(ring.size * float(size), ring.weight * float(weight))
            for ring in design.rings
            for size, weight in zip(edges[1:], weights, strict=True)
        )


class ApplicatorPositionError(SceneEffect):
    """The head misses its target by Gaussian errors of place and depth, new for every movement.

    Parameters
    ----------
    error_mm : standard deviation along x and along y.
    depth_error_mm : standard deviation of the depth.
    """

    class Options(PluginOptions):
        error_mm: Annotated[float, Field(ge=0, le=5)]
        depth_error_mm: Annotated[float, Field(ge=0, le=1)] = 0.0

    after: tuple[str, ...] = ("misplaced-sheet",)
    perturbs = "position"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._stream = RandomStream(setting.seed, "applicator-position-error")

    def apply(self, moment: Moment) -> None:
        x, y, depth = self._stream.normal(moment.index, (3,))
        moment.place_mm = (
            moment.place_mm[0] + self.options.error_mm * float(x),
            moment.place_mm[1] + self.options.error_mm * float(y),
        )
        moment.depth_mm += self.options.depth_error_mm * float(depth)


class Backlash(SceneEffect):
    """Every axis has play: it stops half of the play short of its target.

    The play operator (Visintin 1994): an axis that is within half of its play of its target does not move.

    Parameters
    ----------
    play_mm : play along x and along y.
    depth_play_mm : play of the depth.
    """

    class Options(PluginOptions):
        play_mm: Annotated[float, Field(ge=0, le=5)]
        depth_play_mm: Annotated[float, Field(ge=0, le=1)] = 0.0

    after: tuple[str, ...] = ("misplaced-sheet",)
    perturbs = "position"
    options: Options

    def apply(self, moment: Moment) -> None:
        (x, y), (from_x, from_y) = moment.place_mm, moment.from_mm
        moment.place_mm = (_apply_play(x, from_x, self.options.play_mm), _apply_play(y, from_y, self.options.play_mm))
        moment.depth_mm = _apply_play(moment.depth_mm, moment.from_depth_mm, self.options.depth_play_mm)


def _apply_play(to_mm: float, from_mm: float, play_mm: float) -> float:
    return min(max(from_mm, to_mm - play_mm / 2), to_mm + play_mm / 2)


class MisplacedSheet(SceneEffect):
    """The sheet is shifted and rotated on the station, which displaces all loads together.

    The station's place (x, y) is R(−θ) ((x, y) − (x₀, y₀)) on the sheet.

    Parameters
    ----------
    x_mm, y_mm : place of the sheet's centre on the station.
    rotation_deg : θ, counterclockwise.
    """

    class Options(PluginOptions):
        x_mm: Annotated[float, Field(ge=-20, le=20)] = 0.0
        y_mm: Annotated[float, Field(ge=-20, le=20)] = 0.0
        rotation_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0

    perturbs = "position"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        turn = math.radians(self.options.rotation_deg)
        self._cos, self._sin = math.cos(turn), math.sin(turn)

    def apply(self, moment: Moment) -> None:
        x, y = moment.place_mm[0] - self.options.x_mm, moment.place_mm[1] - self.options.y_mm
        moment.place_mm = (self._cos * x + self._sin * y, self._cos * y - self._sin * x)


class SheetSeat(SceneEffect):
    """The surface of the sheet is off nominal in level and tilt, and may be bent: Gaussian, drawn once per seed.

    Parameters
    ----------
    error_mm : standard deviation of the level, and of the height of the edge along x and along y due to tilt.
    bend_mm : standard deviation of the height by place besides.
    bend_correlation_mm : its correlation length (Gaussian covariance).
    """

    class Options(PluginOptions):
        error_mm: Amount
        bend_mm: Amount = 0.0
        bend_correlation_mm: Positive = 30.0

    perturbs = "geometry"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        stream = RandomStream(setting.seed, "sheet-seat")
        level, along_x, along_y = self.options.error_mm * stream.normal(0, (3,))
        radius_mm = setting.sensor_type.radius_mm
        self._level_mm = float(level)
        self._slope = float(along_x) / radius_mm, float(along_y) / radius_mm
        self._bend = draw_field(stream, self.options.bend_correlation_mm, 1) if self.options.bend_mm else None

    def apply(self, moment: Moment) -> None:
        x_mm, y_mm = moment.place_mm
        moment.surface_mm += self._level_mm + self._slope[0] * x_mm + self._slope[1] * y_mm
        if self._bend is not None:
            moment.surface_mm += self.options.bend_mm * float(self._bend(np.array([[x_mm, y_mm]]))[0])


class PinPositionError(SceneEffect):
    """Every electrode is displaced by Gaussian errors along x and along y, drawn once per seed.

    Parameters
    ----------
    error_mm : standard deviation along each axis.
    """

    class Options(PluginOptions):
        error_mm: Annotated[float, Field(ge=0, le=5)]

    perturbs = "sheet"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._stream = RandomStream(setting.seed, "pin-position-error")

    def design(self, design: SheetDesign) -> None:
        design.shift_mm = design.shift_mm + self.options.error_mm * self._stream.normal(0, design.shift_mm.shape)
