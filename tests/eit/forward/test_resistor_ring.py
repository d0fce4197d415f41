"""The closed form of a ring of resistors against Kirchhoff's laws; a simulated ring is read like one."""

import numpy as np
import pytest
from effect_setting import setting
from hypothesis import given, strategies as st

from cbsr_qa.config.loader import load_scene
from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern, list_pairs
from cbsr_qa.eit.forward.closed_forms import lead_readings, ring_impedance, ring_readings
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.simulate.world import SimulatedWorld

OF = setting()
EFFECTS = discover()


def nodal(resistances_ohm, leads_ohm, pattern):
    """Readings from Kirchhoff's laws: a node for each terminal and, behind its lead, for each electrode."""
    count = len(resistances_ohm)
    branches = [(k, (k + 1) % count, r) for k, r in enumerate(resistances_ohm)]
    branches += [(k, count + k, r) for k, r in enumerate(leads_ohm)]
    conductances = np.zeros((2 * count, 2 * count))
    for a, b, ohm in branches:
        between = np.zeros(2 * count)
        between[[a, b]] = 1, -1
        conductances += np.outer(between, between) / ohm
    free = slice(1, None)  # node 0 is the ground
    readings = np.zeros(pattern.shape)
    for row, (source, sink) in enumerate(pattern.drive):
        current = np.zeros(2 * count)
        current[[count + source, count + sink]] = 1, -1
        potential = np.zeros(2 * count)
        potential[free] = np.linalg.solve(conductances[free, free], current[free])
        for column, (plus, minus) in enumerate(pattern.measure):
            readings[row, column] = potential[count + plus] - potential[count + minus]
    return readings


def pattern_of(drive, measure):
    return DrivePattern(16, list_pairs(drive, 16), list_pairs(measure, 16))


@pytest.mark.parametrize(
    "pattern",
    [adjacent_pattern(16), adjacent_pattern(5), pattern_of("opposite", "adjacent"), pattern_of("skip-3", "opposite")],
)
@pytest.mark.parametrize("uneven", [False, True])
def test_the_closed_form_with_leads_is_what_kirchhoff_says(pattern, uneven):
    random, count = np.random.default_rng(8), pattern.electrode_count
    ohm = 1e4 * (random.uniform(0.1, 3.0, count) if uneven else np.ones(count))
    leads = random.uniform(1.0, 300.0, count)
    closed = ring_readings(ohm, pattern) + lead_readings(pattern) @ leads
    truth = nodal(ohm, leads, pattern)
    assert closed == pytest.approx(truth, abs=1e-11 * np.abs(truth).max())


@given(st.lists(st.floats(1e-3, 1e9), min_size=3, max_size=20))
def test_a_ring_is_reciprocal_and_passive(resistances):
    impedance = ring_impedance(resistances)
    assert (impedance == impedance.T).all()
    # For currents that sum to zero the power is not negative, whatever is driven where.
    count = len(resistances)
    zero_sum = np.eye(count) - np.full((count, count), 1 / count)
    assert np.linalg.eigvalsh(zero_sum @ impedance @ zero_sum).min() >= -1e-12 * np.abs(impedance).max()


@pytest.mark.parametrize("bad", [[1.0, 1.0], [], [[1.0, 1.0, 1.0]]])
def test_what_is_no_ring_is_refused(bad):
    with pytest.raises(NumericsError, match="do not form a ring"):
        ring_impedance(bad)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_a_resistor_that_is_none_is_named(bad):
    with pytest.raises(NumericsError, match="resistor 2 of the ring has"):
        ring_impedance([1.0, 1.0, bad, 1.0])
    with pytest.raises(NumericsError, match="3 resistors does not match a pattern of 16"):
        ring_readings([1.0] * 3, OF.sensor_type.pattern)


def world(effects=(), ring=(2e4,) * 16):
    data = {"scene": dict(load_scene("none").document.data["scene"]), "effects": list(effects)}
    if len(ring):
        data["scene"]["reference_ring_ohm"] = list(ring)
    return SimulatedWorld(
        load_scene(data).value,
        OF.sensor_type,
        OF.material,
        OF.indenter,
        seed=5,
        effect_factory=lambda name: EFFECTS.factory(Kind.EFFECT, name),
    )


def test_a_scene_with_a_ring_reads_the_ring():
    ring = 2e4 * np.random.default_rng(1).uniform(0.9, 1.1, 16)
    frame = world(ring=ring).voltages_V(10.0, 0)
    assert frame == pytest.approx(4e-4 * ring_readings(ring, OF.sensor_type.pattern), rel=1e-12)


def test_leads_and_converters_do_to_a_ring_what_they_do_to_a_sheet_and_contacts_do_nothing():
    pattern = OF.sensor_type.pattern
    plain = world().voltages_V(10.0, 0)
    lead = world([{"name": "lead-resistance", "electrode": 7, "resistance_ohm": 350.0}]).voltages_V(10.0, 0)
    # Of the driven pairs alone: nobody measures through a lead that carries current but they.
    leads = np.zeros(16)
    leads[7] = 350.0
    assert lead - plain == pytest.approx(4e-4 * (lead_readings(pattern) @ leads), abs=1e-12)
    offset = world([{"name": "reading-offset", "offset_V": 3e-3}]).voltages_V(10.0, 0)
    assert offset - plain == pytest.approx(np.full((16, 16), 3e-3), abs=1e-12)
    spread = world([{"name": "contact-spread", "deviation": 0.5}]).voltages_V(10.0, 0)
    assert (spread == plain).all()


def test_noise_in_volts_is_the_stations_whatever_is_connected():
    noise = [{"name": "measurement-noise"}]
    rms_V = []
    for ring in ((), (2e4,) * 16, (2e3,) * 16):
        seen = world(noise, ring)
        frames = np.array([seen.voltages_V(10.0 + k, k) for k in range(6)])
        rms_V.append(frames.std(axis=0, ddof=1).mean())
    assert rms_V[1] == pytest.approx(rms_V[0], rel=1e-9)
    assert rms_V[2] == pytest.approx(rms_V[0], rel=1e-9)


def test_nothing_is_under_the_head():
    seen = world([{"name": "elastic-stress"}])
    assert seen.force_N(10.0, 0) == 0.0


def test_a_ring_of_another_number_of_resistors_is_refused():
    with pytest.raises(ConfigError, match="reference_ring_ohm has 5 resistors; the sensor type has 16 electrodes"):
        world(ring=[1e3] * 5)
