"""Single presses with a wrong place, and electrodes that no pair uses, are named."""

from dataclasses import replace

import numpy as np
import pytest
from pressed_sheets import pressed_sheet

from cbsr_qa.calibration.presses import learn_presses
from cbsr_qa.calibration.presses.odd_labels import (
    far_from_their_labels,
    ignored_columns,
    off_the_sheet,
    unused_electrodes,
)


@pytest.mark.rest
def test_a_press_with_a_wrong_place_is_named_and_one_off_the_sheet():
    pressed = pressed_sheet(40, seed=41, noise=0.05)
    labels, centre = pressed.labels_mm.copy(), np.array([46.0, -408.0])
    labels[5] = centre + (labels[5] - centre) @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    assert 9 < np.linalg.norm(labels[5] - pressed.labels_mm[5]) < 33
    wrong = replace(pressed, labels_mm=labels)
    learned = learn_presses(wrong.labelled())
    (words,) = learned.findings
    assert words.startswith("1 press is far from where the other presses place it, row 6 by ")
    presses = wrong.labelled().presses
    assert not list(off_the_sheet(presses, learned.registration))
    presses.place_mm[7] = centre + np.array([80.5, 3.0])
    (words,) = off_the_sheet(presses, learned.registration)
    assert words.startswith("1 press is outside the sheet of 73 mm radius: row 8, ")


def test_errors_of_usual_size_accuse_no_press():
    labelled, random = pressed_sheet(40, seed=41, noise=0.05).labelled(), np.random.default_rng(0)
    found_mm = labelled.presses.place_mm + random.standard_normal((40, 2))
    assert not list(far_from_their_labels(labelled.presses, np.arange(40), found_mm))
    found_mm[:3] += 30.0
    (words,) = far_from_their_labels(labelled.presses, np.arange(40), found_mm)
    assert words.startswith("3 presses are far from where the others place them, row ")


def test_columns_that_are_no_labels_are_named():
    presses = pressed_sheet(2).labelled().presses
    table = replace(presses.table, columns=("x_mm", "who", "y_mm", "force_N"))
    assert list(ignored_columns(replace(presses, table=table))) == ["presses.csv: ignored columns: 'who'"]
    assert not list(ignored_columns(presses))


def test_electrodes_that_no_pair_uses_are_named():
    pairs = np.array([[0, 1, 2, 3], [3, 4, 7, 0]])
    (words,) = unused_electrodes(pairs, 12)
    assert words.startswith("no pair uses electrodes 5 to 6, 8 to 11 of the 12")
    assert not list(unused_electrodes(np.arange(16).reshape(4, 4), 16))
