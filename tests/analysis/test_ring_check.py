"""What a station does wrong is found on the ring by name: gain, offset, a lead, a resistor, two leads exchanged."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.analysis.ring import check_ring, find_exchanged_electrodes, fit_ring
from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.plan.plan import ReferenceRing
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, VoltageUnit
from cbsr_qa.domain.run.station import CheckOutcome, RingReadings
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern, list_pairs
from cbsr_qa.eit.forward.closed_forms import lead_readings, ring_impedance, ring_readings

PATTERN = adjacent_pattern(16)
ALLOWED = ReferenceRing((1e4,), 0.001, 16, 0.01, 0.01, 1e-3, 1e-3, 100.0)
CURRENT_A = 4e-4
OK, FAILED, NOT_DONE = CheckOutcome.OK, CheckOutcome.FAILED, CheckOutcome.NOT_DONE


def ring(
    readings_ohm=None, *, gain=1.0, offset_V=0.0, noise_V=0.0, frames=16, flags=(), current_A=CURRENT_A, unit="V"
):
    ohm = ring_readings((1e4,) * 16, PATTERN) if readings_ohm is None else readings_ohm
    volts = gain * CURRENT_A * ohm + offset_V
    noise = noise_V * np.random.default_rng(3).standard_normal((frames, 16, 16))
    flagged = np.zeros((frames, 16, 16), dtype=np.uint8)
    for reading in flags:
        flagged[(1, *reading)] = ReadingFlag.COMPLIANCE
    block = FrameBlock(2.5 * np.arange(frames), volts + noise, flagged, VoltageUnit(unit), current_A)
    return RingReadings(block, (1e4,) * 16)


def lines(readings, allowed=ALLOWED, pattern=PATTERN):
    return {line.name: line for line in check_ring(readings, pattern, allowed)}


def outcomes(found):
    return {name for name, line in found.items() if line.outcome is FAILED}


def test_a_perfect_station_reads_the_closed_form():
    found = lines(ring())
    assert outcomes(found) == set()
    for name in ("gain error", "offset", "lead resistance", "worst reading", "noise of a reading"):
        assert found[name].value == pytest.approx(0.0, abs=1e-8), name
    assert {line.subject for line in found.values()} == {"reference ring"}


def test_gain_and_offset_are_told_apart_and_neither_is_a_bad_reading():
    found = lines(ring(gain=0.97, offset_V=2.5e-3))
    assert found["gain error"].value == pytest.approx(-3.0)
    assert found["offset"].value == pytest.approx(2.5)
    assert found["worst reading"].value == pytest.approx(0.0, abs=1e-8)
    assert outcomes(found) == {"gain error", "offset"}
    assert "meter's calibration" in found["gain error"].remedy


def test_a_bad_lead_is_named_and_takes_nothing_else_down():
    leads = np.full(16, 12.0)
    leads[7] = 236.0
    found = lines(ring(ring_readings((1e4,) * 16, PATTERN) + lead_readings(PATTERN) @ leads))
    assert outcomes(found) == {"lead resistance"}
    assert found["lead resistance"].value == pytest.approx(236.0)
    assert found["lead resistance"].said.startswith("largest at electrode 7; mean of all 26 Ω")
    assert "electrode 7" in found["lead resistance"].remedy


def test_a_resistor_that_is_off_shows_as_the_reading_across_it():
    off = np.full(16, 1e4)
    off[3] *= 1.1
    found = lines(ring(ring_readings(off, PATTERN)))
    assert "worst reading" in outcomes(found)
    # Off the pair readings grow by 1.1/(1 + 0.1/16); of what they stand out the fit takes a little for gain.
    assert abs(found["worst reading"].value) == pytest.approx(100 * (1.1 / 1.00625 - 1), abs=1.0)
    assert "across electrodes 3 and 4 are off: check the resistor" in found["worst reading"].remedy
    # Within the tolerance that was stated nothing is wrong.
    wide = lines(ring(ring_readings(off, PATTERN)), replace(ALLOWED, tolerance=0.1))
    assert outcomes(wide) == set()


@pytest.mark.parametrize("pair", [(3, 4), (2, 9)])
def test_exchanged_electrodes_are_found(pair):
    order = np.arange(16)
    order[list(pair)] = pair[::-1]
    swapped = ring_impedance((1e4,) * 16)[np.ix_(order, order)]
    readings = ring(PATTERN.drive_currents().T @ swapped @ PATTERN.measure_matrix(), noise_V=4e-5)
    found = lines(readings)
    assert found["worst reading"].outcome is FAILED
    assert f"electrodes {pair[0]} and {pair[1]} are exchanged" in found["worst reading"].remedy
    assert find_exchanged_electrodes(ring(), PATTERN, within=1e-12) is None


def test_noise_is_the_rms_of_a_reading_over_its_size():
    found = lines(ring(noise_V=1e-4, frames=200))
    # 0.25 V is what all usable readings are; 208 × 199 degrees of freedom tell the rms to 0.35 %.
    assert found["noise of a reading"].value == pytest.approx(400.0, rel=0.02)
    assert outcomes(found) == set()
    # Two frames tell it without bias too: to 1/√(2 · 208), 5 %.
    assert lines(ring(noise_V=1e-4, frames=2))["noise of a reading"].value == pytest.approx(400.0, rel=0.15)
    noisy = lines(ring(noise_V=4e-4))  # 1600 ppm where 1000 are allowed, at 10 kΩ
    assert outcomes(noisy) == {"noise of a reading"}
    assert "a ring of 17000 Ω" in noisy["noise of a reading"].remedy


def test_flagged_readings_are_named_and_left_out():
    readings = ring(flags=[(4, 4)])
    readings.frames.voltages[:, 4, 4] = 0.0
    found = lines(readings)
    assert outcomes(found) == {"flagged readings"}
    assert found["flagged readings"].said == "1 of 256; the first is driven 4–5, measured 4–5: compliance"
    assert found["worst reading"].value == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("electrode", [0, 12])
def test_an_open_lead_is_named_and_nothing_else_fails(electrode):
    """Its two pairs are at compliance; what it measures floats, and says nothing about offset or resistors."""
    driven = [drive for drive, pair in enumerate(PATTERN.drive) if electrode in pair]
    floating = ring_readings((1e4,) * 16, PATTERN)
    floating[:, driven] *= 0.7
    found = lines(ring(floating, flags=[(drive, measure) for drive in driven for measure in range(16)]))
    assert outcomes(found) == {"flagged readings"}
    assert found["flagged readings"].value == 32
    assert (
        f"all readings that electrode {electrode} drives are flagged: it may be open"
        in found["flagged readings"].said
    )
    assert found["flagged readings"].remedy == f"check plug, lead and switch of electrode {electrode}"
    assert found["offset"].value == pytest.approx(0.0, abs=1e-8)


def test_one_drive_at_compliance_is_no_open_lead():
    found = lines(ring(flags=[(3, measure) for measure in range(16)]))
    assert "open" not in found["flagged readings"].said


def test_where_all_are_flagged_there_is_one_line_and_no_number():
    readings = ring(flags=[(d, m) for d in range(16) for m in range(16)])
    (line,) = check_ring(readings, PATTERN, ALLOWED)
    assert (line.outcome, line.value) == (FAILED, None)
    assert line.said.startswith("0 of 256 readings of the ring are without a flag")
    with pytest.raises(NumericsError, match="one frame of a ring does not show noise"):
        fit_ring(ring(frames=1), PATTERN)


@pytest.mark.parametrize("change", [{"unit": "count"}, {"current_A": None}])
def test_readings_nobody_can_scale_are_held_against_each_other(change):
    found = lines(ring(noise_V=1e-5, **change))
    assert (found["gain error"].outcome, found["lead resistance"].outcome) == (NOT_DONE, NOT_DONE)
    assert abs(found["worst reading"].value) < 0.05
    assert found["noise of a reading"].value == pytest.approx(40.0, rel=0.1)
    assert found["offset"].unit == change.get("unit", "V")


def test_a_pattern_that_cannot_tell_leads_and_offset_says_so():
    one = DrivePattern(16, ((0, 1),), ((4, 5), (6, 7), (8, 9)))
    volts = CURRENT_A * ring_readings((1e4,) * 16, one)
    block = FrameBlock(np.arange(4.0), np.tile(volts, (4, 1, 1)), np.zeros((4, 1, 3), np.uint8), "V", CURRENT_A)
    found = lines(RingReadings(replace(block, unit=VoltageUnit.VOLT), (1e4,) * 16), pattern=one)
    assert {name for name, line in found.items() if line.outcome is NOT_DONE} == {"offset", "lead resistance"}
    assert found["gain error"].value == pytest.approx(0.0, abs=1e-9)


def test_frames_without_a_current_are_said_so():
    (line,) = check_ring(ring(current_A=0.0), PATTERN, ALLOWED)
    assert line.said == "the frames were taken without a current"


def test_one_resistance_is_meant_for_all_and_another_number_than_electrodes_is_refused():
    assert replace(ALLOWED, resistance_ohm=(50.0,)).resistances_ohm(3) == (50.0,) * 3
    with pytest.raises(ConfigError, match="has 3 values; the sensor type has 16 electrodes"):
        replace(ALLOWED, resistance_ohm=(1.0, 2.0, 3.0)).resistances_ohm(16)


PATTERNS = {
    "adjacent": PATTERN,
    "opposite driven": DrivePattern(16, list_pairs("opposite", 16), list_pairs("adjacent", 16)),
    "skipping": DrivePattern(16, list_pairs("skip-2", 16), list_pairs("skip-1", 16)),
}


@pytest.mark.parametrize("name", PATTERNS)
@given(
    gain=st.floats(0.5, 2.0),
    offset_V=st.floats(-0.1, 0.1),
    leads=st.lists(st.floats(0.0, 500.0), min_size=16, max_size=16),
    ohm=st.lists(st.floats(5e3, 2e4), min_size=16, max_size=16),
)
@drawn(25)
def test_what_made_the_readings_is_found_again_whatever_the_pattern_and_the_resistors(
    name, gain, offset_V, leads, ohm
):
    pattern = PATTERNS[name]
    volts = gain * CURRENT_A * (ring_readings(ohm, pattern) + lead_readings(pattern) @ np.array(leads)) + offset_V
    block = FrameBlock(
        np.arange(2.0), np.tile(volts, (2, 1, 1)), np.zeros((2, *volts.shape), np.uint8), VoltageUnit.VOLT, CURRENT_A
    )
    fit = fit_ring(RingReadings(block, tuple(ohm)), pattern)
    assert fit.gain_error == pytest.approx(gain - 1, abs=1e-9)
    assert fit.offset == pytest.approx(offset_V, abs=1e-9)
    assert fit.lead_ohm == pytest.approx(gain * np.array(leads), abs=1e-4)
    assert np.abs(fit.residual).max() < 1e-8
