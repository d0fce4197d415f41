"""Effects on readings and electrodes: each alone against its closed form."""

from itertools import pairwise

import numpy as np
import pytest
from drawn import drawn
from effect_setting import applied, moment, plain_sheet, setting, world_of
from hypothesis import given, strategies as st
from scipy.constants import Boltzmann
from scipy.signal import lfilter

from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa_plugins.effects.board import ConverterSaturation, Quantisation, ReadingMemory, ReadingOffset, TimeSkew
from cbsr_qa_plugins.effects.electrodes import ContactDrift, ElectrodeShort, LeadResistance
from cbsr_qa_plugins.effects.readings import JohnsonNoise, MainsHum, SourceCompliance

OF = setting()
INNER = ["measure", "drive"]
RANDOM = np.random.default_rng(4)


def read(voltages, time_s=0.0, index=0):
    at = moment(OF, time_s, index=index)
    at.voltages = np.array(voltages, dtype=np.float64)
    at.flags = np.zeros(at.voltages.shape, dtype=np.uint8)
    return at


@pytest.fixture(scope="module")
def sheet():
    return plain_sheet()


@pytest.mark.parametrize(("inner", "first", "last"), [("measure", (0, 1), (15, 14)), ("drive", (1, 0), (14, 15))])
def test_readings_follow_each_other_through_the_frame(inner, first, last):
    at = applied(TimeSkew(OF, share=0.8, inner=inner), read(np.zeros((16, 16))))
    offsets = at.reading_offsets_s
    step = 0.8 * OF.frame_period_s / 256
    assert np.diff(np.sort(offsets.ravel())) == pytest.approx(step)
    assert offsets[first] - offsets[0, 0] == pytest.approx(step)
    assert offsets[15, 15] - offsets[last] == pytest.approx(step)
    assert offsets.mean() == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("inner", ["measure", "drive"])
@pytest.mark.parametrize("share", [0.0, 0.12, 0.5])
def test_memory_is_the_recursion_it_says(inner, share):
    plain = RANDOM.standard_normal((16, 16))
    at = applied(ReadingMemory(OF, share=share, inner=inner), read(plain))
    found = at.voltages.ravel() if inner == "measure" else at.voltages.T.ravel()
    order = plain.ravel() if inner == "measure" else plain.T.ravel()
    assert found == pytest.approx((1 - share) * order + share * np.roll(found, 1), abs=1e-14)


def test_memory_follows_the_order_in_which_readings_are_taken():
    """With `time-skew` on, its order; another one is refused."""
    voltages = np.random.default_rng(3).normal(size=(16, 16))
    for inner in ("measure", "drive"):
        skewed, plain = read(voltages), read(voltages)
        TimeSkew(OF, inner=inner).apply(skewed)
        ReadingMemory(OF, share=0.2).apply(skewed)
        ReadingMemory(OF, share=0.2, inner=inner).apply(plain)
        assert np.array_equal(skewed.voltages, plain.voltages)
        other = "drive" if inner == "measure" else "measure"
        with pytest.raises(RefusedError, match=f"inner = '{other}', while time-skew steps the '{inner}' pair"):
            ReadingMemory(OF, share=0.2, inner=other).apply(skewed)


def remembered(frame, share, inner):
    """Readings of one frame in the order they are taken in."""
    at = applied(ReadingMemory(OF, share=share, inner=inner), read(frame))
    return at.voltages.ravel() if inner == "measure" else at.voltages.T.ravel()


@drawn(30)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0, 0.9), step=st.floats(0, 10), inner=st.sampled_from(INNER))
def test_what_a_frame_does_not_remember_of_the_one_before_is_bounded_as_documented(seed, share, step, inner):
    """Against one converter that remembers through frame after frame: reading n is off by m^(n + 1) d at most."""
    random = np.random.default_rng(seed)
    frames = [random.standard_normal((16, 16))]
    for _ in range(2):
        frames.append(frames[-1] + step * random.uniform(-1, 1, (16, 16)))
    largest = max(np.abs(after - before).max() for before, after in pairwise(frames))
    stream = np.concatenate([frame.ravel() if inner == "measure" else frame.T.ravel() for frame in frames])
    first = remembered(frames[0], share, inner)  # where the world begins
    through = lfilter([1 - share], [1, -share], stream, zi=[share * first[-1]])[0].reshape(3, 256)
    for frame, expected in zip(frames, through, strict=True):
        error = np.abs(remembered(frame, share, inner) - expected)
        assert (error <= share ** np.arange(1, 257) * largest + 1e-13 * (1 + step)).all()


@pytest.mark.parametrize("nplc", [0.01, 0.3, 1.5])
def test_hum_is_a_sine_averaged_over_each_reading(nplc):
    at = applied(TimeSkew(OF), read(np.zeros((16, 16)), time_s=12.34))
    MainsHum(OF, amplitude_V=0.01, nplc=nplc).apply(at)
    times = 12.34 + at.reading_offsets_s
    window = nplc / 50
    phase = MainsHum(OF, amplitude_V=1.0)._phase
    rate = 2 * np.pi * 50
    expected = (np.cos(rate * (times - window / 2) + phase) - np.cos(rate * (times + window / 2) + phase)) / (
        rate * window
    )
    assert at.voltages == pytest.approx(0.01 * expected, abs=1e-9)


@pytest.mark.parametrize("nplc", [1, 2, 10])
def test_whole_cycles_hear_no_hum(nplc):
    at = applied(TimeSkew(OF), read(np.zeros((16, 16))))
    MainsHum(OF, amplitude_V=0.01, nplc=nplc).apply(at)
    assert np.abs(at.voltages).max() < 1e-17


def test_a_quantised_sine_has_the_error_of_its_steps():
    """Uniform within half a step: deviation step/√12, and no reading further off."""
    sine = np.sin(np.linspace(0, 200, 256 * 64)).reshape(64, 16, 16)
    step = 2 * 2.0 / 2**12
    errors = []
    for frame in sine:
        at = applied(Quantisation(OF, range_V=2.0, bits=12), read(frame))
        errors.append(at.voltages - frame)
        assert np.abs(at.voltages / step - np.round(at.voltages / step)).max() < 1e-9
    assert np.abs(errors).max() <= step / 2 * (1 + 1e-9)
    assert np.std(errors) == pytest.approx(step / np.sqrt(12), rel=0.02)


def test_beyond_the_range_readings_are_its_end_and_flagged():
    at = read(np.linspace(-3, 3, 256).reshape(16, 16))
    before = at.voltages.copy()
    ConverterSaturation(OF, range_V=2.0).apply(at)
    assert np.array_equal(at.voltages, np.clip(before, -2, 2))
    assert np.array_equal(at.flags, np.where(np.abs(before) >= 2, ReadingFlag.SATURATED, 0))


def test_an_offset_is_on_every_reading():
    plain = RANDOM.standard_normal((16, 16))
    at = applied(ReadingOffset(OF, offset_V=-0.02), read(plain))
    assert at.voltages == pytest.approx(plain - 0.02)


def test_thermal_noise_is_nyquists(sheet):
    effect, drawn = JohnsonNoise(OF, nplc=0.01, temperature_C=23.0), []
    impedance, pairs = sheet.impedance({}), OF.sensor_type.pattern.measure_matrix()
    ohm = np.diag(pairs.T @ impedance @ pairs)
    for index in range(300):
        at = read(np.zeros((16, 16)), index=index)
        drawn.append(applied(effect, at, measure_ohm=np.tile(ohm, (16, 1))).voltages)
    expected = np.sqrt(4 * Boltzmann * 296.15 * ohm / (2 * 0.01 / 50))
    assert np.std(drawn, axis=(0, 1)) == pytest.approx(expected, rel=5 / np.sqrt(2 * 4800))
    assert ohm.mean() == pytest.approx(1e4)


def test_a_source_at_its_limit_gives_what_the_limit_gives():
    drive_ohm, current_A = np.tile(np.linspace(1e4, 4e4, 16)[:, None], 16), np.full((16, 16), 1e-3)
    limit = SourceCompliance(OF, limit_V=20.0)
    at = applied(limit, read(np.zeros((16, 16))), drive_ohm=drive_ohm, current_A=current_A)
    limited = at.drive_ohm > 2e4
    assert at.current_A == pytest.approx(np.where(limited, 20 / at.drive_ohm, 1e-3))
    assert np.array_equal((at.flags & ReadingFlag.COMPLIANCE) > 0, limited)
    assert (at.current_A * at.drive_ohm <= 20 * (1 + 1e-12)).all()


def test_a_lead_is_seen_by_its_own_driven_pairs_alone(sheet):
    plain, lead = sheet.impedance({}), LeadResistance(OF, electrode=5, resistance_ohm=700.0, from_s=40.0, to_s=60.0)
    at, later = (applied(lead, moment(OF, time_s), impedance_ohm=plain) for time_s in (50.0, 60.0))
    change = sheet.readings(at.impedance_ohm) - sheet.readings(plain)
    expected = np.zeros((16, 16))
    expected[4, 4] = expected[5, 5] = 700.0
    expected[4, 5] = expected[5, 4] = -700.0
    assert change == pytest.approx(expected, abs=1e-8)
    assert np.array_equal(later.impedance_ohm, plain)


@pytest.mark.parametrize("ohm", [0.0, 300.0])
def test_a_short_is_a_conductor_beside_the_sheet(sheet, ohm):
    """Kirchhoff at the electrodes: U = Z (I − a i), i = aᵀU/r, for every drive."""
    plain, short = sheet.impedance({}), ElectrodeShort(OF, electrodes=[3, 9], resistance_ohm=ohm)
    at = applied(short, moment(OF, 0.0), impedance_ohm=plain)
    between = np.zeros(16)
    between[3], between[9] = 1, -1
    for current in OF.sensor_type.pattern.drive_currents().T:
        system = np.block([[np.eye(16), (plain @ between)[:, None]], [between[None], np.array([[-ohm]])]])
        solved = np.linalg.solve(system, np.append(plain @ current, 0.0))[:16]
        assert at.impedance_ohm @ current == pytest.approx(solved, abs=1e-8)
        if not ohm:
            assert between @ at.impedance_ohm @ current == pytest.approx(0, abs=1e-8)


@pytest.mark.parametrize(
    "pair", [(0, 15), *(pytest.param(p, marks=pytest.mark.rest) for p in ((3, 4), (7, 8), (10, 11)))]
)
def test_a_driven_pair_that_is_shorted_is_at_no_limit_and_has_no_noise(pair):
    """What rounding leaves of its resistance, of either sign, is none: |R i| is far below every limit."""
    short = ("electrode-short", {"electrodes": list(pair)})
    effects = (("source-compliance", {}), short, ("voltmeter-input", {}), ("johnson-noise", {}))
    for seed in range(3):
        frame = world_of(*effects, seed=seed, contact_length_mm=0.2 + 0.01 * seed).frame(1.0, 0)
        shorted = np.array([set(pair) == set(driven) for driven in OF.sensor_type.pattern.drive])
        assert not frame.flags.any()
        assert np.abs(frame.voltages[shorted][:, shorted]).max() < 1e-9
        assert np.abs(frame.voltages).max() < 20.0


def test_what_lies_outside_the_sheet_does_not_warm_with_it():
    lead = ("lead-resistance", {"electrode": 5, "resistance_ohm": 100.0})
    with pytest.raises(ConfigError, match="'lead-resistance' before 'temperature-drift'"):
        world_of(lead, ("temperature-drift", {"coefficient_per_K": 0.02}))


def test_contacts_drift_exponentially_each_at_its_own_rate():
    effect = ContactDrift(OF, deviation_per_hour=0.3)
    seen = [applied(effect, moment(OF, t), contact_mm=np.full(16, 0.2)) for t in (0.0, 1800.0, 3600.0)]
    found = [np.log(at.contact_mm / 0.2) for at in seen]
    assert found[0] == pytest.approx(0)
    assert found[2] == pytest.approx(2 * found[1])
    assert 0.1 < found[2].std() < 0.6


def test_contacts_that_drift_out_of_all_bounds_are_refused():
    with pytest.raises(RefusedError, match=r"contact \d+ e\^-?\d+ of what it was at 360000 s") as refused:
        applied(ContactDrift(OF, deviation_per_hour=10.0), moment(OF, 3.6e5), contact_mm=np.full(16, 0.2))
    assert "deviation_per_hour" in refused.value.remedy


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: TimeSkew(OF, inner="both"), "inner is 'both'"),
        (lambda: TimeSkew(OF, share=1.2), "share is 1.2"),
        (lambda: ReadingMemory(OF, share=1.0), "from 0 to 0.9"),
        (lambda: MainsHum(OF, amplitude_V=0.1, nplc=0.0), "nplc is 0"),
        (lambda: Quantisation(OF, range_V=2.0, bits=2), "bits is 2"),
        (lambda: JohnsonNoise(OF, temperature_C=-300.0), "temperature_C is -300"),
        (lambda: SourceCompliance(OF, limit_V=0.0), "limit_V is 0"),
        (lambda: LeadResistance(OF, electrode=16, resistance_ohm=1.0), "electrodes are numbered from 0 to 15"),
    ],
)
def test_parameters_that_make_no_sense_are_named(made, said):
    with pytest.raises(ConfigError, match=said):
        made()
