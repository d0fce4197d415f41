"""The times of the press under way, until its rest has ended and it is recorded."""

from dataclasses import dataclass, field

from cbsr_qa.domain.readings.loads import EasedStrain, Load, LoadRecord
from cbsr_qa.system.clock import round_to_ticks


@dataclass(slots=True)
class LoadLog:
    """The press under way.

    Parameters
    ----------
    times_s : press start, hold start, release start, release end, as far as reached.
    lift_off_s : time from the start of the lift until the head leaves the sheet; None if unknown.
    """

    index: int = -1
    load: Load | None = None
    times_s: list[float] = field(default_factory=list)
    lift_off_s: float | None = None
    eased: list[EasedStrain] = field(default_factory=list)

    def begin(self, index: int, load: Load, now_s: float, lift_off_s: float) -> None:
        self.index, self.load, self.times_s, self.lift_off_s = index, load, [now_s], lift_off_s
        self.eased = []

    def ease(self, strain: float, start_s: float, now_s: float, lift_off_s: float) -> None:
        """Record that the head moved to another strain, from a time until now."""
        self.eased.append(EasedStrain(strain, start_s, now_s))
        self.lift_off_s = lift_off_s

    def mark(self, now_s: float) -> None:
        """Record that the head is down, starts up, or is up."""
        self.times_s.append(now_s)

    def lose_track(self) -> None:
        """Drop the time the head left the sheet: the way up was not one movement, so it is unknown."""
        self.lift_off_s = None

    def finish(self, now_s: float) -> LoadRecord | None:
        """Return the record of a press whose rest has ended, or None."""
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
        # In ticks, like all times of a run; a head that is up has left the sheet.
        return min(release_s + round_to_ticks(self.lift_off_s), up_s)
