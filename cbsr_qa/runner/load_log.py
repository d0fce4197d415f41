"""Times of the press under way, until its rest is over and it becomes a record."""

from dataclasses import dataclass, field

from cbsr_qa.clock import in_ticks
from cbsr_qa.domain.loads import EasedStrain, Load, LoadRecord


@dataclass(slots=True)
class LoadLog:
    """The press under way.

    Parameters
    ----------
    times_s : press start, hold start, release start, release end, as far as they have happened.
    lift_off_s : how long the head needs to leave the sheet once it starts up; None where nobody knows.
    """

    index: int = -1
    load: Load | None = None
    times_s: list[float] = field(default_factory=list)
    lift_off_s: float | None = None
    eased: list[EasedStrain] = field(default_factory=list)

    def begin(self, index: int, load: Load, now_s: float, lift_off_s: float) -> None:
        """The head starts down."""
        self.index, self.load, self.times_s, self.lift_off_s = index, load, [now_s], lift_off_s
        self.eased = []

    def ease(self, strain: float, start_s: float, now_s: float, lift_off_s: float) -> None:
        """The head has gone to another strain, from a time up to now."""
        self.eased.append(EasedStrain(strain, start_s, now_s))
        self.lift_off_s = lift_off_s

    def mark(self, now_s: float) -> None:
        """The head is down; then it starts up; then it is up."""
        self.times_s.append(now_s)

    def lose_track(self) -> None:
        """The way up was not one movement: when the head left the sheet is not known."""
        self.lift_off_s = None

    def finish(self, now_s: float) -> LoadRecord | None:
        """The rest is over: return the record of a press that came to its end, or None where there is none."""
        if self.load is None or len(self.times_s) != 4:
            return None
        press_s, hold_s, release_s, up_s = self.times_s
        times = (press_s, hold_s, release_s, up_s, now_s, self._clear_s())
        record = LoadRecord(self.index, self.load, *times, eased=tuple(self.eased))
        self.load = None
        return record

    def _clear_s(self) -> float | None:
        if self.lift_off_s is None:
            return None
        _, _, release_s, up_s = self.times_s
        # In ticks, as all times of a run; and a head that is up has left the sheet.
        return min(release_s + in_ticks(self.lift_off_s), up_s)
