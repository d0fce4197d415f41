"""The way back is not the way there."""

from cbsr_qa.domain.scene import Moment, SceneSetting, SimulatedPress
from cbsr_qa.simulate.parameters import number


class Hysteresis:
    """Once a press has begun to lift, the response follows a higher curve until it is as deep again as it was.

    On the way back from the deepest strain ε_m of the press the change at a strain ε is larger by
    4 width α ε_m x (1 − x), x = ε/ε_m: rate-independent, closed at both ends, widest half-way.

    Parameters
    ----------
    width : of the loop over the change at its tip.
    """

    needs: tuple[str, ...] = ("piezoresistivity",)
    perturbs = "response"
    memory_s = 0.0

    def __init__(self, setting: SceneSetting, *, width: float) -> None:
        self._slope = setting.material.against_strain.slope.value
        self._width = number("width", width, most=0.5)

    def apply(self, moment: Moment) -> None:
        """Add what the way back is higher by, of every press."""
        for index, press in enumerate(moment.presses):
            strain = press.strain_at(moment.time_s)
            if strain > 0:  # closed at the loop's lower end
                deepest = _deepest_so_far(press, moment.time_s)
                share = min(strain / deepest, 1.0)
                moment.response[index] += 4 * self._width * self._slope * deepest * share * (1 - share)


def _deepest_so_far(press: SimulatedPress, time_s: float) -> float:
    """Largest strain up to a time: at the end of a ramp, or now."""
    ends = [step.start_s + step.ramp_s for step in press.steps]
    return max([press.strain_at(end) for end in ends if end <= time_s] + [press.strain_at(time_s)])
