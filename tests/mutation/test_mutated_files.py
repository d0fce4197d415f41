"""Two hundred files with changed bytes; ``make soak`` reads twenty thousand."""

import pytest
from mutated import found_wrong


@pytest.mark.parametrize("first", range(0, 200, 50))
def test_a_changed_file_is_read_or_refused_soon(tmp_path, first):
    assert found_wrong(tmp_path, range(first, first + 50)) == []
