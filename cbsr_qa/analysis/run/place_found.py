"""Place as learned from a run's presses, its errors, and whether it pays."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from cbsr_qa.domain.results.learned_place import PlaceOfRun

if TYPE_CHECKING:
    from cbsr_qa.calibration.place.learning import PlaceLearned

#: Number of its standard errors beyond which a difference of means counts.
_CLEAR: Final = 2.0


@dataclass(frozen=True, slots=True)
class PlaceErrors:
    """Mean distance between found and pressed places of the same presses, by both estimates.

    Parameters
    ----------
    presses : number of presses.
    learned_mm, modelled_mm : errors of the place as learned without them, and of the place by the model of the sheet
        [mm].
    gain_mm, gain_stderr_mm : mean difference by which the learned place is nearer [mm], and its standard error;
        presses at one place count once for its standard error.
    """

    presses: int
    learned_mm: float
    modelled_mm: float
    gain_mm: float
    gain_stderr_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class RunPlace:
    """Place as learned from a run's presses.

    Parameters
    ----------
    learned : None if nothing was, for the reason ``why``.
    places : number of different places it was learned from.
    left_out : errors of the presses it was learned from, each located without those at its place.
    others : errors of loads all over the sheet that do not calibrate; None without any. They decide nothing.
    """

    learned: "PlaceLearned | None"
    why: str = ""
    places: int = 0
    left_out: PlaceErrors | None = None
    others: PlaceErrors | None = None

    @property
    def pays(self) -> bool:
        """Whether it is nearer than the model of the sheet by more than two standard errors, on presses left out."""
        errors = self.left_out
        return errors is not None and errors.gain_mm > _CLEAR * errors.gain_stderr_mm

    @property
    def used(self) -> PlaceOfRun | None:
        """Learned place that a calibration keeps; None unless it pays."""
        if self.learned is None or self.left_out is None or not self.pays:
            return None
        errors = self.left_out
        return PlaceOfRun(
            self.learned.model, errors.presses, errors.learned_mm, errors.modelled_mm, errors.gain_stderr_mm
        )

    @property
    def words(self) -> str:
        """The result and its reason in one sentence."""
        if self.left_out is None:
            return f"Place not learned: {self.why}"
        cv, others = self.left_out, self.others
        at = "" if self.places == cv.presses else f" at {self.places} places"
        sentence = (
            f"Place learned from {cv.presses} presses{at}: {cv.learned_mm:.2g} mm on presses left out, the model of"
            f" the sheet {cv.modelled_mm:.2g} mm (difference {cv.gain_mm:+.2g} ± {cv.gain_stderr_mm:.1g} mm)"
        ).replace("-", "−")
        if others is not None:
            sentence += f"; {others.learned_mm:.2g} and {others.modelled_mm:.2g} mm on {others.presses} other loads"
        if self.pays:
            return f"{sentence}: clearly nearer, so a calibration uses it"
        better = cv.gain_mm < -_CLEAR * cv.gain_stderr_mm
        return f"{sentence}: not used, the model is {'better' if better else 'as good'}"
