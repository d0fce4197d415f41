"""Contacts told from the driven pairs, in words."""

import numpy as np
import pytest

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern, list_pairs
from cbsr_qa_plugins.hardware._contact_check import ContactState, contact_faults
from cbsr_qa_plugins.hardware._esp32 import stepping_order

RING = adjacent_pattern(16)
INF = np.inf


def ohm(pattern=RING, **of_pair):
    """18 kΩ, but for pairs like p6_7."""
    value = np.full(len(pattern.drive), 18.1e3)
    for name, found in of_pair.items():
        value[pattern.drive.index(tuple(map(int, name[1:].split("_"))))] = found
    return value


def found(values, pattern=RING):
    return [(fault.state, fault.pins) for fault in contact_faults(pattern, values)]


def test_good_contacts_have_no_faults():
    assert contact_faults(RING, np.random.default_rng(1).uniform(12e3, 27e3, 16)) == ()


OPEN, POOR, TOUCH = ContactState
SAID = {
    "pin 7 open: pairs 6-7 and 7-8 read 1.2 MΩ and more than the source can drive": {"p6_7": 1.2e6, "p7_8": INF},
    "pin 7 open: pairs 6-7 and 7-8 read more than the source can drive": {"p6_7": INF, "p7_8": INF},
    "pin 0 open: pairs 0-1 and 15-0 read more than the source can drive": {"p15_0": INF, "p0_1": INF},
    "pins 6 or 7 open: pair 6-7 reads 200 kΩ": {"p6_7": 200e3},
    "pins 6 and 7 touch: pair 6-7 reads 12 Ω": {"p6_7": 12.0, "p5_6": 15e3},
}


@pytest.mark.parametrize("said", SAID)
def test_a_fault_is_said_with_its_pins_and_what_their_pairs_read(said):
    (fault,) = contact_faults(RING, ohm(**SAID[said]))
    assert fault.words() == f"{said}, the median pair 18.1 kΩ"


@pytest.mark.parametrize(
    ("pairs", "faults"),
    [
        ({"p5_6": INF, "p6_7": INF, "p7_8": INF}, [(OPEN, (6,)), (OPEN, (7,))]),
        ({"p5_6": INF, "p6_7": INF, "p7_8": INF, "p8_9": INF}, [(OPEN, (6,)), (OPEN, (8,))]),
        ({"p6_7": 40e3, "p7_8": 45e3}, [(POOR, (7,))]),
        (
            {"p0_1": 1.0, "p6_7": INF, "p7_8": INF, "p10_11": 40e3, "p11_12": 40e3},
            [(OPEN, (7,)), (POOR, (11,)), (TOUCH, (0, 1))],
        ),
    ],
    ids=["two beside each other", "one between two", "poor is not open", "open ones first"],
)
def test_pins_are_told_from_their_pairs(pairs, faults):
    assert found(ohm(**pairs)) == faults


def test_pins_that_pairs_cannot_tell_apart_are_named_together():
    opposite = DrivePattern(16, list_pairs("opposite", 16), list_pairs("adjacent", 16))
    assert found(ohm(opposite, p2_10=INF), opposite) == [(OPEN, (2, 10))]


def test_no_sensor_at_all_is_every_pin():
    faults = contact_faults(RING, np.full(16, INF))
    assert {fault.state for fault in faults} == {OPEN}
    assert {pair for fault in faults for pair in fault.pairs} == set(RING.drive)
    assert "median" not in faults[0].words()


def test_the_order_of_a_firmware_in_which_the_current_pair_is_inner():
    order = stepping_order(RING, inner="current")
    assert order[:2] == ((0, 0), (1, 0))
    assert order[16] == (0, 1)
    assert len(set(order)) == 256


def test_the_order_of_a_firmware_in_which_the_voltage_pair_is_inner():
    assert stepping_order(RING, inner="voltage")[:17] == (*((0, m) for m in range(16)), (1, 0))


def test_a_firmware_that_skips_electrodes():
    skipping = DrivePattern(16, list_pairs("skip-2", 16), list_pairs("adjacent", 16))
    assert set(stepping_order(skipping, inner="current", current_skip=2)) == {
        (d, m) for d in range(16) for m in range(16)
    }
    with pytest.raises(
        RefusedError, match=r"drive pairs 0-1, 1-2 and so on; pair 0-1 is not among the sensor type's"
    ):
        stepping_order(skipping, inner="current")


def test_pairs_of_the_sensor_that_the_firmware_lacks():
    both_ways = DrivePattern(16, (*RING.drive, (1, 0)), RING.measure)
    with pytest.raises(RefusedError, match=r"pair 1-0 is of the sensor type, not among its own"):
        stepping_order(both_ways, inner="current")
