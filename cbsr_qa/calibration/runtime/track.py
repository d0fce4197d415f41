"""One load of a stream: its place, its strength so far, and its prediction."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.runtime.hold_onset import UnsureHold
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import ForceModel
from cbsr_qa.domain.results.relaxation import RelaxationKernel

#: Frames that determine the state of a new load's place before it.
KEPT: Final = 8
#: A load is released when its strength falls by this share of its largest, and by so many standard errors.
_MIN_DROP_SHARE: Final = 0.2
_MIN_NOISE_RATIO: Final = 5.0
#: A first frame with less than this share of the value expected from the second was taken while the head moved.
_PARTIAL: Final = 0.75
#: A load has changed when its strength is so many standard errors, and this share, off its hold's; and changes again
#: when it moves by so much since.
_OFF: Final = 5.0
_OFF_SHARE: Final = 0.05
#: Share of the slowest time constant before which changes are not checked, since place and trajectory are still being
#: learned; and number of successive frames that confirm a change.
_EARLY: Final = 0.5
_BELIEVED: Final = 2
_MOVED: Final = 0.1
#: Number of last frames compared together with the prediction from earlier ones, to detect gradual steps.
_LAST: Final = 8
_OFF_TOGETHER: Final = 4.0
_SHARE_TOGETHER: Final = 0.025
#: A load was only lightened, not released, if this share more of it remains than of released ones.
_STAYS: Final = 0.2
#: Uncertainty of a decaying strength from frame to frame.
_FADING_ERROR: Final = 0.1
_FADING_NOISE: Final = 0.1  # relative to the noise of a single frame
#: Share of a released change that may persist for minutes: an order of magnitude (paper 4.2).
_RESIDUE: Final = 0.02
#: Duration of a load's settling, and possible later change of its strength, without a kernel.
_PATIENCE_S: Final = 60.0
_UNKNOWN_CHANGE: Final = 0.3
#: Released loads have faded after so many times the slowest constant; and times that are tried.
_FADED: Final = 3.0
#: Standard errors below the threshold of a load until which the residue of a load shows in single frames.
_ROOM: Final = 2.0
_STEPS: Final = 200
#: Frames after which a place is no longer updated.
_PLACED: Final = 40


class Track:
    """One load.

    Parameters
    ----------
    number, place_mm, template : number of the load, its place (2,), and the change (r,) per strength there.
    since_s : time when the load appeared.
    base : strength at its place before it appeared.
    sign : sign of the response.
    """

    def __init__(
        self, number: int, place_mm: Array, template: Array, since_s: float, base: float, sign: float
    ) -> None:
        self.number = number
        self.place_mm = np.array(place_mm)
        self.template = template
        self.since_s = since_s
        self.base = base
        self.sign = sign
        self.state = "loading"
        self.strength = 0.0
        self.noise = 1.0
        self.expected = 0.0
        self.precision = 0.0
        self.unseen = 0
        self.base_now = base
        self._information = np.zeros((2, 2))
        self._weighed = np.zeros(2)
        self._frames = 0
        self._largest = 0.0
        self._released = 0.0
        self._first: tuple[float, float, float] | None = None
        self._hold: UnsureHold | None = None
        self._promise: UnsureHold | None = None  # hold of all but the last frames
        self._last: list[tuple[float, float, float]] = []
        self._changed: tuple[float, float] | None = None
        self._now_s = self._pressed_s = since_s
        self._off = 0

    @property
    def pressing(self) -> bool:
        return self.state in ("loading", "steady")

    @property
    def place_covariance(self) -> Array:
        """Covariance of the place from noise, (2, 2) [mm²]."""
        if self._frames == 0:
            return np.zeros((2, 2))
        return np.asarray(np.linalg.inv(self._information), dtype=np.float64)

    @property
    def fresh(self) -> bool:
        """Whether it presses and only its first frame was seen, possibly of a moving head."""
        return self.pressing and self._frames <= 1 and self._first is not None

    def move(self, place_mm: Array, template: Array, base: float) -> None:
        """Move the load to another place, and discard earlier estimates of its place."""
        self.place_mm, self.template = np.array(place_mm), template
        self.base = self.base_now = base
        self._information, self._weighed, self._frames = np.zeros((2, 2)), np.zeros(2), 0

    def distance_mm(self, place_mm: Array) -> float:
        return float(np.hypot(*(self.place_mm - place_mm)))

    def add_place(self, place_mm: Array, covariance: Array) -> None:
        if self._frames >= _PLACED or not np.isfinite(covariance).all():
            return
        if covariance[0, 0] <= 0 or np.linalg.det(covariance) <= 0:  # noise on a ridge between places
            return
        information = np.linalg.inv(covariance)
        self._information = self._information + information
        self._weighed = self._weighed + information @ place_mm
        self._frames += 1
        self.place_mm = np.asarray(np.linalg.solve(self._information, self._weighed), dtype=np.float64)

    def advance(self, time_s: float, frame_s: float, since_last_s: float, model: ForceModel) -> None:
        """Add the strength found in a frame, with the frame's duration and the time since the last one."""
        self._now_s = time_s
        if self.pressing:
            self._press(time_s, frame_s, model)
        if not self.pressing:
            self._fade(time_s, since_last_s, model)

    def start_unknown(self) -> None:
        """The load was there when the stream began, or after a long gap: it may have begun to settle long before."""
        self._changed = (self.since_s, 0.0)

    def time_to_settle_s(self, model: ForceModel, share: float) -> float:
        """Time until less than a share of the force is still to come, or what is left of a released load is noise.

        0 where that is so; NaN for a residue that stays.
        """
        if not self.pressing:
            return self._time_to_fade_s(model)
        changed_s = self._find_change_s()
        since_s = self.since_s if changed_s is None else changed_s
        end_s = model.steady_s or _PATIENCE_S
        after_s = np.linspace(0.0, end_s, _STEPS)
        if changed_s is not None or model.loading is None:
            remaining_share = _UNKNOWN_CHANGE * np.exp(-after_s / patience_s(model))
        else:
            kernel_values = kernel_at(model.loading, after_s)
            remaining_share = np.abs(kernel_values / kernel_values[-1] - 1)
        unsettled_steps = np.flatnonzero(remaining_share > share)
        settled_s = after_s[min(int(unsettled_steps[-1]) + 1, _STEPS - 1)] if len(unsettled_steps) else 0.0
        return max(float(since_s + settled_s - self._now_s), 0.0)

    def _time_to_fade_s(self, model: ForceModel) -> float:
        least = max(model.threshold - _ROOM, 1.0) / float(np.linalg.norm(self.template))
        if abs(self.strength) <= least:
            return 0.0
        if model.unloading is None:
            return max(self.since_s + _PATIENCE_S - self._now_s, 0.0) or float("nan")
        after_s = np.linspace(0.0, _FADED * _slowest_s(model.unloading), _STEPS)
        held_s = self._now_s - self.since_s
        remaining = _remaining_share(model.unloading, held_s + after_s)
        faded = np.flatnonzero(abs(self.strength) * remaining <= least * remaining[0])
        return float(after_s[faded[0]]) if len(faded) else float("nan")

    def steady(self, model: ForceModel) -> tuple[float, float]:
        """Strength after the calibrated hold, and its variance."""
        load_strength = self.strength - self.base_now
        single_stderr = 1 / float(np.linalg.norm(self.template))
        base = (model.residue_stderr * model.residue_strength) ** 2 + (
            model.residue_share * single_stderr
        ) ** 2 / KEPT
        if (changed_s := self._find_change_s()) is not None:
            change = _UNKNOWN_CHANGE * load_strength * float(np.exp(-(self._now_s - changed_s) / patience_s(model)))
            return load_strength, self.noise**2 + change**2 + base
        if self._hold is None or model.loading is None:
            change = 0.0 if self.state == "steady" else _UNKNOWN_CHANGE * load_strength
            return load_strength, self.noise**2 + change**2 + base
        value, stderr = self._hold.predict(model.steady_s)
        return value, stderr**2 + base

    def _find_change_s(self) -> float | None:
        """Time when the load itself changed; the present time if its last frame alone says so."""
        if self._changed is not None:
            return self._changed[0]
        return self._now_s if self._off else None

    def _press(self, time_s: float, frame_s: float, model: ForceModel) -> None:
        towards = self.sign * self.strength
        if self._largest - towards > max(_MIN_DROP_SHARE * self._largest, _MIN_NOISE_RATIO * self.noise):
            self._pressed_s = self.since_s
            self.state, self.since_s = "unloading", time_s - frame_s / 2
            self._released = self.sign * self._largest
            self._hold = self._promise = self._first = None
            return
        self._largest = max(self._largest, towards)
        share = model.residue_share
        self.base_now = self.base * (share + (1 - share) * float(np.exp(-(time_s - self.since_s) / 25.0)))
        self._notice_change(time_s, model)
        if self._changed is None and not self._off:
            self._learn(time_s, frame_s, model)
        from_s = self.since_s if self._changed is None else self._changed[0]
        self.state = "steady" if time_s - from_s >= (model.steady_s or _PATIENCE_S) else "loading"

    def _notice_change(self, time_s: float, model: ForceModel) -> None:
        """Detect that the load itself changed: its hold no longer predicts it, and only observed values count."""
        load_strength = self.strength - self.base_now
        if self._changed is not None:
            if abs(load_strength - self._changed[1]) > max(_MOVED * abs(load_strength), _OFF * self.noise):
                self._changed = (time_s, load_strength)
        elif self._hold is not None and model.loading is not None:
            held_s = max(time_s - self.since_s, 0.0)
            expected, stderr = self._hold.predict(held_s)
            is_off = abs(load_strength - expected) > max(
                _OFF * float(np.hypot(stderr, self.noise)), _OFF_SHARE * abs(load_strength)
            )
            is_off |= self._are_off_together()
            self._off = self._off + 1 if is_off and held_s > _EARLY * patience_s(model) else 0
            if self._off >= _BELIEVED:
                self._changed = (time_s, load_strength)

    def _are_off_together(self) -> bool:
        """Whether the last frames together deviate from the prediction of those before."""
        if self._promise is None or self._promise.frames < _LAST // 2:
            return False
        held_s, strengths, noise = np.array(self._last).T
        expected, stderr = self._promise.predict(float(held_s.mean()))
        error = float(np.hypot(stderr, np.sqrt((noise**2).sum()) / len(noise)))
        deviation = abs(float(strengths.mean()) - expected)
        return deviation > max(_OFF_TOGETHER * error, _SHARE_TOGETHER * abs(float(strengths.mean())))

    def _learn(self, time_s: float, frame_s: float, model: ForceModel) -> None:
        """Add a frame to the hold; the first waits for the second, which shows whether the head was still moving."""
        if model.loading is None:
            return
        load_strength = self.strength - self.base_now
        if self._hold is None and self._first is None:
            self._first = (time_s, load_strength, self.noise)
            self._hold = UnsureHold(model.loading, frame_s)
            self._add(*self._first)
            return
        if self._first is not None:
            first_frame, self._first = self._first, None
            kernel_before, kernel_now = kernel_at(model.loading, np.array([first_frame[0], time_s]) - self.since_s)
            expected = float(kernel_before / kernel_now)
            self._hold, self._promise = UnsureHold(model.loading, frame_s), UnsureHold(model.loading, frame_s)
            self._last.clear()
            if self.sign * first_frame[1] < _PARTIAL * expected * self.sign * load_strength:
                self.since_s = max(first_frame[0] + frame_s / 2, self.since_s)
            else:
                self._add(*first_frame)
        self._add(time_s, load_strength, self.noise)

    def _add(self, time_s: float, own: float, noise: float) -> None:
        assert self._hold is not None
        held_s = max(time_s - self.since_s, 0.0)
        self._hold.add(held_s, own, noise)
        self._last.append((held_s, own, noise))
        if len(self._last) > _LAST and self._promise is not None:
            self._promise.add(*self._last.pop(0))

    def _lighten(self, time_s: float) -> None:
        self.state, self.since_s = "loading", self._pressed_s
        self._changed = (time_s, self.strength - self.base_now)
        self._largest = self.sign * self.strength
        self.expected = self.precision = 0.0
        self.unseen = 0

    def _fade(self, time_s: float, since_last_s: float, model: ForceModel) -> None:
        rate = 1.0
        if model.unloading is not None:
            held_s = time_s - self.since_s
            remaining_share = float(_remaining_share(model.unloading, held_s))
            rate = float(_remaining_share(model.unloading, held_s + since_last_s)) / remaining_share
            largest_share = remaining_share + _STAYS
            if (
                self.sign * self.strength > max(largest_share * self._released, _MIN_NOISE_RATIO * self.noise)
                and held_s > 0
            ):
                self._lighten(time_s)
                return
        self.expected = self.strength * float(np.clip(rate, 0.0, 1.0))
        single_stderr = 1 / float(np.linalg.norm(self.template))
        self.precision = 1 / (_FADING_ERROR * abs(self.strength) + _FADING_NOISE * single_stderr) ** 2
        is_fresh = time_s - self.since_s < (_FADED * _slowest_s(model.unloading) if model.unloading else _PATIENCE_S)
        self.state = "unloading" if is_fresh else "residue"
        self.unseen = 0 if abs(self.strength) > single_stderr else self.unseen + 1


def patience_s(model: ForceModel) -> float:
    """Slowest time constant of a press [s]."""
    return _slowest_s(model.loading) if model.loading else _PATIENCE_S


def _slowest_s(kernel: RelaxationKernel) -> float:
    return float(kernel.time_constants_s[-1]) if len(kernel.weights) else _PATIENCE_S


def kernel_at(kernel: RelaxationKernel, time_s: ArrayLike) -> Array:
    """K(t), at least a twentieth, so that a strength divided by it remains a strength."""
    return np.maximum(1 + _transient(kernel.weights, kernel, time_s), 0.05)


def _remaining_share(kernel: RelaxationKernel, time_s: ArrayLike) -> Array:
    """Share of a released load that is left."""
    return _RESIDUE + _transient(np.abs(kernel.weights), kernel, time_s)


def _transient(weights: Array, kernel: RelaxationKernel, time_s: ArrayLike) -> Array:
    elapsed_s = np.maximum(np.asarray(time_s, dtype=np.float64), 0.0)
    total: Array = np.sum(weights * np.exp(-elapsed_s[..., None] / kernel.time_constants_s), axis=-1)
    return total
