"""Effects on how frames are written down, held to the distributions they state."""

import re
from pathlib import Path

import numpy as np
import pytest
from effect_setting import setting
from scipy.stats import binomtest, chisquare

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.world import Transcript
from cbsr_qa.plugin.interfaces import RecordingEffect
from cbsr_qa_plugins.effects.board import FrameLoss, WatchdogDump

FRAMES = 4000
ROWS = 16
ONE_IN_A_MILLION = 1e-6


def recorded(effect, frames=FRAMES, *, of=None):
    transcript = Transcript.complete(of or setting(), 2.5 * np.arange(frames))
    effect.record(transcript)
    return transcript


def runs(lost):
    """First row and length of the run of every frame that lost rows; each must be one run."""
    out = []
    for frame in lost[lost.any(axis=1)]:
        rows = np.flatnonzero(frame)
        assert rows[-1] - rows[0] + 1 == len(rows)
        out.append((rows[0], len(rows)))
    return np.array(out)


# --- frame-loss ---


@pytest.mark.parametrize("share", [0.02, 0.3])
def test_the_share_of_frames_that_lose_rows_is_binomial(share):
    lost = recorded(FrameLoss(setting(), share=share)).lost
    assert binomtest(lost.any(axis=1).sum(), FRAMES, share).pvalue > ONE_IN_A_MILLION


def test_runs_begin_at_any_row_alike_and_are_of_any_length_alike():
    found = runs(recorded(FrameLoss(setting(), share=1.0, most_rows=4)).lost)
    assert len(found) == FRAMES
    assert chisquare(np.bincount(found[:, 0], minlength=ROWS)).pvalue > ONE_IN_A_MILLION
    uncut = found[found[:, 0] <= ROWS - 4, 1]
    assert chisquare(np.bincount(uncut, minlength=5)[1:]).pvalue > ONE_IN_A_MILLION
    assert set(found[found[:, 0] == ROWS - 1, 1]) == {1}  # the end of the frame cuts the run


def test_no_frame_is_lost_at_a_share_of_zero_and_every_one_at_one():
    assert not recorded(FrameLoss(setting(), share=0)).lost.any()
    assert recorded(FrameLoss(setting(), share=1, most_rows=1)).lost.sum(axis=1).tolist() == [1] * FRAMES


# --- watchdog-dump ---


@pytest.mark.parametrize(("period_s", "pause_ms"), [(5.0, 75.0), (7.3, 2000.0), (0.4, 0.0)])
def test_dumps_come_regularly_on_the_boards_own_clock(period_s, pause_ms):
    """The n-th stands before the first row that would be read after the first one's time and n periods."""
    of = setting()
    transcript = recorded(WatchdogDump(of, period_s=period_s, pause_ms=pause_ms), 400)
    row_s = of.frame_period_s / ROWS
    rows = np.array([dump.frame * ROWS + dump.row for dump in transcript.dumps])
    late_s = np.concatenate([[0.0], np.cumsum([dump.pause_s for dump in transcript.dumps])[:-1]])
    at_s = transcript.time_s[0] - of.frame_period_s / 2 + rows * row_s + late_s
    due_s = at_s[0] + period_s * np.arange(len(rows))
    assert (np.abs(at_s - due_s) < row_s * (1 + 1e-9)).all()
    assert len(rows) == pytest.approx(400 * of.frame_period_s / (period_s - pause_ms / 1000), abs=1.5)


@pytest.mark.rest
def test_the_first_dump_is_anywhere_in_the_first_period():
    def first_s(seed):
        (dump, *_) = recorded(WatchdogDump(setting(seed=seed), period_s=100.0), 200).dumps
        return (dump.frame + dump.row / ROWS) * setting().frame_period_s

    found = np.histogram([first_s(seed) for seed in range(400)], 8, (0, 100))[0]
    assert chisquare(found).pvalue > ONE_IN_A_MILLION


def test_a_dump_makes_the_rest_of_the_recording_later_by_its_pause():
    transcript = recorded(WatchdogDump(setting()), 200)
    assert len(transcript.dumps) > 10
    late_s = transcript.pauses_s().ravel()
    assert late_s[-1] == pytest.approx(0.075 * len(transcript.dumps))
    steps = np.flatnonzero(np.diff(late_s, prepend=0.0))
    assert set(steps) == {dump.frame * ROWS + dump.row for dump in transcript.dumps}


# --- both ---

BOTH = [lambda of: FrameLoss(of, share=0.2), lambda of: WatchdogDump(of, period_s=3.0)]


@pytest.mark.parametrize("effect", BOTH)
def test_a_longer_recording_repeats_the_beginning_of_a_shorter_one(effect):
    short, long = recorded(effect(setting()), 150), recorded(effect(setting()), 400)
    np.testing.assert_array_equal(short.lost, long.lost[:150])
    assert short.dumps == [dump for dump in long.dumps if dump.frame < 150]
    assert short.dumps or short.lost.any()


@pytest.mark.parametrize("effect", BOTH)
def test_the_seed_says_what_happens(effect):
    def told(seed):
        transcript = recorded(effect(setting(seed=seed)), 400)
        return transcript.lost.tobytes(), tuple(transcript.dumps)

    assert told(1) == told(1)
    assert told(1) != told(2)


@pytest.mark.parametrize(
    ("make", "named", "allowed"),
    [
        (lambda: FrameLoss(setting(), share=1.5), "share is 1.5", "from 0 to 1"),
        (lambda: FrameLoss(setting(), share=0.1, most_rows=0), "most_rows is 0", "whole number from 1"),
        (lambda: FrameLoss(setting(), share=0.1, most_rows=2.5), "most_rows is 2.5", "whole"),
    ],
)
def test_what_cannot_be_is_refused_with_what_can(make, named, allowed):
    with pytest.raises(ConfigError) as said:
        make()
    assert named in said.value.reason
    assert allowed in said.value.remedy


def test_the_effect_of_the_plugin_page_is_one():
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "write-a-plugin.md").read_text(encoding="utf-8")
    (block,) = [part for part in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "def record(" in part]
    namespace = {}
    exec(block, namespace)
    effect = namespace["FirstRowLoss"](setting(), share=0.3)
    assert isinstance(effect, RecordingEffect)
    lost = recorded(effect).lost
    assert binomtest(lost[:, 0].sum(), FRAMES, 0.3).pvalue > ONE_IN_A_MILLION
    assert not lost[:, 1:].any()
