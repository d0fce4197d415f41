"""What readings and labels say together: whether drift can be told from place."""

import numpy as np
import pytest
from pressed_sheets import pressed_sheet, some


@pytest.mark.parametrize("count", [20, 60])
def test_presses_in_the_order_of_their_places_are_seen(count):
    sheet = pressed_sheet(count)
    x, y = sheet.places_mm.T
    for order in (np.argsort(x - 2 * y), np.argsort(np.hypot(x, y))):
        assert some(sheet, order).labelled().by_place()
    by_chance = [some(sheet, np.random.default_rng(seed).permutation(count)).labelled() for seed in range(200)]
    assert sum(each.by_place() for each in by_chance) <= 2
