"""Electrodes that fail: open, open now and then, noisy, and a voltmeter that loads them; against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import drawn
from effect_setting import applied, moment, plain_sheet, setting, world_of
from hypothesis import given, strategies as st
from scipy.stats import kstest

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.world import SimulatedPress, StrainRamp
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa.simulate.streams import RandomStream
from cbsr_qa_plugins.effects.electrodes import ElectrodeIntermittent, ElectrodeOpen
from cbsr_qa_plugins.effects.readings import ElectrodeNoise, VoltmeterInput

OF = setting()
PATTERN = OF.sensor_type.pattern
OPEN_OHM = 1e9
LIMIT_V = 20.0
LIMIT = ("source-compliance", {"limit_V": LIMIT_V})
#: drive and measure pairs of electrode 5, which are the same
OF_FIVE = np.array([5 in pair for pair in PATTERN.drive])


@pytest.fixture(scope="module")
def impedance():
    return plain_sheet().impedance({})


# --- open ---


def test_an_open_electrode_lets_its_pairs_carry_what_the_limit_drives():
    whole = world_of().frame(5.0, 0)
    broken = world_of(LIMIT, ("electrode-open", {"electrode": 5})).frame(5.0, 0)
    drive_ohm = np.diag(whole.voltages) / 4e-4
    current_A = np.where(OF_FIVE, LIMIT_V / (drive_ohm + OPEN_OHM), 4e-4)
    through = OF_FIVE[:, None] & OF_FIVE  # readings that see the lead's own drop
    expected = whole.voltages / 4e-4 * current_A[:, None]
    np.testing.assert_allclose(broken.voltages[~through], expected[~through], rtol=1e-12, atol=1e-15)
    assert np.diag(broken.voltages)[OF_FIVE] == pytest.approx(LIMIT_V, rel=1e-12)
    first, second = np.flatnonzero(OF_FIVE)
    assert broken.voltages[first, second] == pytest.approx(-LIMIT_V, rel=1e-4)
    assert np.array_equal((broken.flags & ReadingFlag.COMPLIANCE) > 0, np.tile(OF_FIVE[:, None], 16))


def test_before_and_after_it_is_open_the_electrode_is_whole():
    broken = world_of(LIMIT, ("electrode-open", {"electrode": 5, "from_s": 10.0, "to_s": 20.0}))
    whole = world_of(LIMIT)
    for time_s, same in ((9.9, True), (10.0, False), (19.9, False), (20.0, True)):
        assert np.array_equal(broken.frame(time_s, 0).voltages, whole.frame(time_s, 0).voltages) == same


@pytest.mark.parametrize(
    "effect",
    [
        ("electrode-open", {"electrode": 5}),
        ("electrode-intermittent", {"electrode": 5, "mean_open_s": 1.0, "mean_closed_s": 1.0}),
    ],
)
def test_without_a_limit_an_open_electrode_is_refused(effect):
    with pytest.raises(ConfigError, match="without 'source-compliance'"):
        world_of(effect)


# --- intermittent ---


def open_at(effect, times_s, of=OF):
    """Whether the lead is open at each time."""
    found = []
    for time_s in times_s:
        at = applied(effect, moment(of, float(time_s)), impedance_ohm=np.zeros((16, 16)))
        found.append(at.impedance_ohm[5, 5] == OPEN_OHM)
        assert np.count_nonzero(at.impedance_ohm) == found[-1]
    return np.array(found)


def intermittent(open_s=2.0, closed_s=6.0, seed=1):
    return ElectrodeIntermittent(replace(OF, seed=seed), electrode=5, mean_open_s=open_s, mean_closed_s=closed_s)


def runs_s(effect, end_s):
    """Lengths of the whole open and closed runs up to an end, from the effect's own events [s]."""
    events = [event for block in range(int(end_s / effect._block_s)) for event in effect._events(block)]
    changes = [
        (at_s, mark) for (at_s, mark), (_, before) in zip(events[1:], events[:-1], strict=True) if mark != before
    ]
    lengths = np.diff([at_s for at_s, _ in changes])
    opened = np.array([mark for _, mark in changes[:-1]])
    return lengths[opened], lengths[~opened]


def test_open_and_closed_runs_are_exponential_with_the_stated_means():
    opened, closed = runs_s(intermittent(), 40_000.0)
    for lengths, mean_s in ((opened, 2.0), (closed, 6.0)):
        assert lengths.mean() == pytest.approx(mean_s, rel=5 / np.sqrt(len(lengths)))
        assert kstest(lengths / mean_s, "expon").pvalue > 1e-3
        # a run knows nothing of the one before
        assert abs(np.corrcoef(lengths[1:], lengths[:-1])[0, 1]) < 5 / np.sqrt(len(lengths))


def test_it_is_open_for_its_share_of_the_time_from_the_first_moment_on():
    share = open_at(intermittent(), np.arange(0.0, 16_000.0, 4.0)).mean()
    # Samples 4 s apart are correlated by e^(−4 (1/2 + 1/6)): 7 %.
    assert share == pytest.approx(0.25, abs=5 * np.sqrt(0.25 * 0.75 / 4000 * 1.15))
    first = np.mean([open_at(intermittent(seed=seed), [0.0])[0] for seed in range(1000)])
    assert first == pytest.approx(0.25, abs=5 * np.sqrt(0.25 * 0.75 / 1000))


@drawn(30)
@given(times=st.lists(st.floats(0, 5e4), min_size=2, max_size=12), open_s=st.floats(0.02, 50))
def test_times_may_be_asked_for_in_any_order(times, open_s):
    one, other = intermittent(open_s=open_s), intermittent(open_s=open_s)
    forward = open_at(one, times)
    backward = open_at(other, times[::-1])[::-1]
    assert np.array_equal(forward, backward)
    assert np.array_equal(forward, open_at(one, times))


def test_the_state_holds_between_its_events_across_blocks():
    effect = intermittent()
    events = [event for block in range(20) for event in effect._events(block)]
    ends = [at_s for at_s, _ in events[1:]] + [20 * effect._block_s]
    for (at_s, mark), end_s in zip(events, ends, strict=True):
        assert open_at(effect, [at_s, (at_s + end_s) / 2]).tolist() == [mark, mark]


def test_a_resumed_session_goes_on_with_the_history():
    times = np.arange(0.0, 400.0, 4.0)
    whole = open_at(intermittent(), times + 120.0)
    assert 0 < whole.sum() < len(whole)
    resumed = replace(OF, began_s=120.0)
    assert np.array_equal(open_at(intermittent(), times, of=resumed), whole)
    # Its switches come 120 s earlier on the session's clock.
    effect = intermittent()
    late = effect.switches(moment(OF, 130.0), 125.0, 175.0)
    early = effect.switches(moment(resumed, 10.0), 5.0, 55.0)
    assert late
    assert early == pytest.approx([at_s - 120.0 for at_s in late])


def test_a_lead_that_opens_at_a_time_of_the_run_opens_then_in_a_resumed_session_too():
    effect = ElectrodeOpen(OF, electrode=5, from_s=100.0, to_s=200.0)
    times = np.array([0.0, 50.0, 110.0])
    assert open_at(effect, times + 90.0).tolist() == open_at(effect, times, of=replace(OF, began_s=90.0)).tolist()
    assert effect.switches(moment(replace(OF, began_s=90.0), 0.0), 0.0, 20.0) == [10.0]


def test_closed_frames_are_those_of_a_whole_electrode_and_open_ones_those_of_an_open_one():
    options = {"electrode": 5, "mean_open_s": 5.0, "mean_closed_s": 5.0}
    here, whole, broken = (
        world_of(LIMIT, *more)
        for more in ([("electrode-intermittent", options)], [], [("electrode-open", {"electrode": 5})])
    )
    kinds = set()
    for time_s in np.arange(1.25, 60.0, 2.5):
        found = here.frame(float(time_s), 0)
        is_open = bool(found.flags.any())
        expected = (broken if is_open else whole).frame(float(time_s), 0)
        assert np.array_equal(found.voltages, expected.voltages)
        assert np.array_equal(found.flags, expected.flags)
        kinds.add(is_open)
    assert kinds == {True, False}


@pytest.mark.parametrize("inner", ["measure", "drive"])
@pytest.mark.parametrize(
    ("effect", "options"),
    [
        ("electrode-open", {"electrode": 5, "from_s": 10.1, "to_s": 11.7}),
        ("electrode-intermittent", {"electrode": 5, "mean_open_s": 0.6, "mean_closed_s": 0.4}),
    ],
)
def test_readings_in_turn_see_a_lead_open_or_whole_and_nothing_between(effect, options, inner):
    """Every reading is that of a frame in which all are taken at its own time, source and voltmeter included."""
    meter = ("voltmeter-input", {"input_ohm": 1e8, "bias_A": 1e-9})
    in_turn = world_of(LIMIT, ("time-skew", {"inner": inner}), (effect, options), meter).frame(11.25, 9)
    at_once = world_of(LIMIT, (effect, options), meter)
    frames = [at_once.frame(float(time_s), 9) for time_s in in_turn.time_s.ravel()]
    expected = np.array([frame.voltages.ravel()[k] for k, frame in enumerate(frames)]).reshape(16, 16)
    flags = np.array([frame.flags.ravel()[k] for k, frame in enumerate(frames)]).reshape(16, 16)
    assert len({bool(frame.flags.any()) for frame in frames}) == 2
    np.testing.assert_array_equal(in_turn.flags, flags)
    np.testing.assert_allclose(in_turn.voltages, expected, rtol=1e-9, atol=1e-12)


def test_a_lead_that_opens_just_as_a_ramp_ends_is_whole_before_and_open_after():
    """Times of ramps are sums with rounding: one may end a little before a step, or between it and its own knot."""
    lead = ("electrode-open", {"electrode": 5, "from_s": 10.1})
    for early_s in (1e-15, 1e-7, 1.5e-6, 2.5e-6):
        broken = world_of(LIMIT, ("time-skew", {}), lead)
        broken.presses.append(SimulatedPress(0, 0.0, 0.0, [StrainRamp(9.0, 1.1 - early_s, 0.2)]))
        found = broken.frame(11.25, 0)
        expected = OF_FIVE[:, None] & (found.time_s >= 10.1)
        assert np.array_equal((found.flags & ReadingFlag.COMPLIANCE) > 0, expected)


# --- noisy ---


def test_noise_of_an_electrode_is_its_address_in_a_stream_of_its_own():
    noise = ElectrodeNoise(setting(seed=9), electrode=2, relative_noise=0.5)
    at = applied(noise, moment(setting(seed=9), 0.0, index=3), voltages=np.zeros((16, 16)))
    numbers = RandomStream(9, "electrode-noise").normal(3, (16, 16))
    used = np.array([2 in pair for pair in PATTERN.drive])
    assert at.voltages == pytest.approx(np.where(used[:, None] | used, numbers, 0.0), abs=1e-15)


# --- voltmeter ---


def loaded(impedance, current_A, **parameters):
    """Readings per pair, alone and through a voltmeter."""
    at = moment(OF, 0.0)
    drives, measures = PATTERN.drive_currents(), PATTERN.measure_matrix()
    at.current_A = np.tile(current_A[:, None], 16)
    at.drive_ohm = np.tile(np.einsum("ed,ef,fd->d", drives, impedance, drives)[:, None], 16)
    at.measure_ohm = np.tile(np.einsum("em,ef,fm->m", measures, impedance, measures), (16, 1))
    plain = (drives.T @ impedance @ measures) * current_A[:, None]
    at.voltages = plain
    VoltmeterInput(OF, **parameters).apply(at)
    return plain, at.voltages


@pytest.mark.parametrize("electrode_ohm", [0.0, 3e4])
def test_a_voltmeter_is_a_resistor_and_a_current_beside_the_pair(impedance, electrode_ohm):
    """Kirchhoff: U = Z (I − m U_m/R_in + m i), U_m = mᵀU, for every drive and every measured pair."""
    input_ohm, bias_A = 5e4, 2e-7
    worn = impedance + electrode_ohm * np.diag(np.arange(16) == 5)
    _, found = loaded(worn, np.full(16, OF.current_A), input_ohm=input_ohm, bias_A=bias_A)
    for drive, current in enumerate(OF.current_A * PATTERN.drive_currents().T):
        for measure, pair in enumerate(PATTERN.measure_matrix().T):
            seen = worn @ pair
            potentials = np.linalg.solve(
                np.eye(16) + np.outer(seen, pair) / input_ohm, worn @ current + bias_A * seen
            )
            assert found[drive, measure] == pytest.approx(pair @ potentials, rel=1e-9, abs=1e-9)


def test_a_pair_held_at_the_sources_limit_is_not_pulled_down(impedance):
    """With the driven pair held at a voltage: its current is what Kirchhoff's laws ask for."""
    input_ohm, bias_A = 5e4, 2e-7
    drives = PATTERN.drive_currents()
    drive_ohm = np.einsum("ed,ef,fd->d", drives, impedance, drives)
    limit_V = 0.5 * OF.current_A * drive_ohm.min()
    _, found = loaded(impedance, limit_V / drive_ohm, input_ohm=input_ohm, bias_A=bias_A)
    assert np.diag(found) == pytest.approx(limit_V)
    for drive, driven in enumerate(drives.T):
        for measure, pair in enumerate(PATTERN.measure_matrix().T):
            if measure == drive:
                continue
            # unknown: the source's current and the voltmeter's
            ohm = np.array([[driven @ impedance @ driven, driven @ impedance @ pair]] * 2)
            ohm[1] = pair @ impedance @ driven, pair @ impedance @ pair + input_ohm
            currents = np.linalg.solve(ohm, [limit_V, input_ohm * bias_A])
            reading = input_ohm * (bias_A - currents[1])
            assert found[drive, measure] == pytest.approx(reading, rel=1e-9, abs=1e-12)


def test_a_pair_with_an_open_lead_reads_the_bias_whatever_is_driven(impedance):
    broken = impedance + 1e12 * np.diag(np.arange(16) == 5)
    _, found = loaded(broken, np.full(16, OF.current_A), input_ohm=1e7, bias_A=1e-9)
    # Away from the electrode's own driven pairs: 10 MΩ × 1 nA, to R_in/R.
    assert found[np.ix_(~OF_FIVE, OF_FIVE)] == pytest.approx(0.01, rel=1e-2)
