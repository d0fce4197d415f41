"""A way to calibrate a sensor on the station: places, durations, evaluation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, sunflower_mm
from cbsr_qa.domain.results.dimensions import Dimensions
from cbsr_qa.studies.frontier.point import Knob
from cbsr_qa.studies.simulated import copy_shipped

#: Shipped recipe that provides imaging, metrics and limits, and the options of phases that settings leave open.
BASE: Final = "campaign"
#: Names of the phases of every recipe of the frontier.
START, GRID, CHECK, HELD_OUT = "noise figure", "calibration places", "random loads", "held-out loads"
#: Ways to choose places, see :class:`Setting`.
SUNFLOWER, FARTHEST, LEAST_SURE = "sunflower", "farthest first", "least sure first"
#: Radius of every grid, 40 mm from the centre as in the paper.
RADIUS_MM: Final = 40.0
_LONG_S: Final = 60.0
_USUAL_FRAME_S: Final = 2.5
#: Least rest around the random loads, which determine relaxation: residues would bias it.
_CHECK_REST_S: Final = 30.0
#: Shortest rest: two frames show what is left of earlier loads.
_LEAST_REST_S: Final = 5.0
#: Number of random loads for a scatter of forces.
_MANY: Final = 10


@dataclass(frozen=True, slots=True)
class Setting:
    """One way to calibrate.

    Parameters
    ----------
    places : number; nine are the paper's, others a sunflower over the disc of 40 mm.
    strains_percent, trials : strains and number of trials at each place.
    hold_s, rest_s : time held and time of rest of each press.
    predicted : whether short holds are extrapolated to the end of long ones (transient compensation).
    steady_frames : averaged at the end of each hold.
    first_rest_s : before the first press.
    checks : random loads held for a minute, for relaxation and the accuracy of force.
    frame_period_s : duration of a frame; its noise falls with the square root (NPLC of the source meter).
    plane : whether the surface is touched at three places, and not at each.
    clearance_mm : height above the sheet at which the head travels; None for the station's hover height.
    residue_percent : residue at the next place, in per cent of its change, at which rests end; None for fixed rests.
    drift : of readings, as a share of a frame's noise, below which the first rest ends; None for a fixed one.
    few_frames : whether phases after the first take four unloaded frames, and not sixteen.
    choice : choice of places: ``"sunflower"``, as in a recipe; or out of thirty ``"farthest first"`` or ``"least sure
        first"``, which evaluates the loads before the next choice.
    """

    places: int
    strains_percent: tuple[float, ...] = (25.0,)
    trials: int = 1
    hold_s: float = _LONG_S
    rest_s: float = 60.0
    predicted: bool = False
    steady_frames: int = 4
    first_rest_s: float = 240.0
    checks: int = 2
    frame_period_s: float = _USUAL_FRAME_S
    choice: str = SUNFLOWER
    plane: bool = False
    clearance_mm: float | None = None
    residue_percent: float | None = None
    drift: float | None = None
    few_frames: bool = False

    @property
    def knobs(self) -> dict[str, Knob]:
        """Settings, for tables and documents; what saves time per press only where it is used."""
        savings: dict[str, Knob | None] = {
            "surface": "plane" if self.plane else None,
            "clearance_mm": self.clearance_mm,
            "residue_percent": self.residue_percent,
            "drift": self.drift,
            "unloaded_frames": 4 if self.few_frames else None,
        }
        is_quick = any(value is not None for value in savings.values())
        quick = {name: "–" if value is None else value for name, value in savings.items()} if is_quick else {}
        return {
            "places": self.places,
            "strains": len(self.strains_percent),
            "trials": self.trials,
            "hold_s": self.hold_s,
            "rest_s": self.rest_s,
            "transients": "predicted" if self.predicted else "averaged",
            "frames": self.steady_frames,
            "frame_s": self.frame_period_s,
            "choice": self.choice,
            **quick,
        }

    @property
    def is_recipe(self) -> bool:
        """Whether a recipe can express it: a recipe sets no frame time, and does not choose places during the run."""
        return self.choice == SUNFLOWER and self.frame_period_s == _USUAL_FRAME_S

    def locations_mm(self) -> tuple[tuple[float, float], ...]:
        return NINE_LOCATIONS_MM if self.places == len(NINE_LOCATIONS_MM) else sunflower_mm(self.places, RADIUS_MM)

    def recipe(self, name: str = "frontier") -> dict[str, Any]:
        """Return a recipe document; all that is not set here is as in the shipped recipe ``campaign``."""
        recipe = copy_shipped(DocumentKind.RECIPE, BASE)
        recipe["recipe"] = {"name": name, "calibrate_phases": [GRID]}
        recipe["phases"] = self._phases(recipe["phases"])
        recipe["limits"] = [limit for limit in recipe["limits"] if self._measures(limit)]
        recipe["analysis"] = {
            **recipe["analysis"],
            "transients": "predicted" if self.predicted else "averaged",
            "steady_frames": self.steady_frames,
            "learn_place": self.places > len(NINE_LOCATIONS_MM),  # nine presses teach less than any model
        }
        return recipe

    def _measures(self, limit: Mapping[str, Any]) -> bool:
        """Whether such a calibration can meet a limit of the base; limits that need more presses are left out."""
        needs = {
            "repeatability": self.trials > 1,
            "nonlinearity": len(self.strains_percent) > 2,
            "force_error_sd": self.checks >= _MANY,
            "force_error_bias": self.checks >= _MANY,
            "force_coverage_68": self.checks >= _MANY,
            "common_settling_time": Dimensions.from_qualifier(limit.get("qualifier", "")).direction != "unloading"
            or self.rest_s >= _LONG_S,
        }
        return needs.get(limit["measurement"], True)

    def _phases(self, base: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Three phases of the base with this setting's places, loads and times."""
        keys_by_phase: dict[str, dict[str, Any]] = {
            START: {
                "rest_s": self.first_rest_s,
                "frames": 20,
                "trials": 1,
                "recovery_s": min(self.rest_s, 30.0),
            },
            GRID: {
                "locations_mm": [list(place) for place in self.locations_mm()],
                "strains_percent": list(self.strains_percent),
                "trials": self.trials,
                "hold_s": self.hold_s,
                "rest_s": self.rest_s,
                "initial_rest_s": 0.0,
            },
            CHECK: {
                "count": self.checks,
                "strain_percent": [15.0, 30.0],
                "rest_s": max(self.rest_s, _CHECK_REST_S),
                "initial_rest_s": max(_CHECK_REST_S - self.rest_s, 0.0),
            },
        }
        for name, keys in keys_by_phase.items():
            keys.update(self._quick_options(name))
        if not self.checks:
            del keys_by_phase[CHECK]
        return [{**phase, **keys_by_phase[phase["name"]]} for phase in base if phase["name"] in keys_by_phase]

    def _quick_options(self, phase: str) -> dict[str, Any]:
        """Options of a phase for less time per press; only those that are used."""
        first = phase == START
        surfaces: dict[str, dict[str, Any]] = {GRID: {"surface": "plane"}, CHECK: {"find_surface": False}}
        rests = {"residue_percent": self.residue_percent, "least_rest_s": min(self.rest_s, _LEAST_REST_S)}
        return {
            **(surfaces.get(phase, {}) if self.plane else {}),
            **({} if self.clearance_mm is None else {"clearance_mm": self.clearance_mm}),
            **({} if self.residue_percent is None or first else rests),
            **({} if self.drift is None or not first else {"drift": self.drift}),
            **({"unloaded_before": True} if self.few_frames and not first else {}),
        }


def phase_of_test_loads(count: int) -> dict[str, Any]:
    """Return the phase of random loads used to test simulated sensors, pressed as in the base (and the paper)."""
    (check,) = (phase for phase in copy_shipped(DocumentKind.RECIPE, BASE)["phases"] if phase["name"] == CHECK)
    return {**check, "name": HELD_OUT, "stream": "held-out", "count": count, "initial_rest_s": 0.0}
