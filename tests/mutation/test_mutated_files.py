"""Two hundred files with changed bytes; ``make soak`` reads twenty thousand."""

import pytest
from mutated import found_wrong

MORE = [pytest.param(first, marks=pytest.mark.rest) for first in (50, 100, 150)]


@pytest.mark.parametrize("first", [0, *MORE])
def test_a_changed_file_is_read_or_refused_soon(tmp_path, first):
    assert found_wrong(tmp_path, range(first, first + 50)) == []
