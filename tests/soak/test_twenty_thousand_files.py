"""Calibrations and recordings with changed bytes: none crashes, hangs, fills the memory or is an internal error."""

import pytest
from mutated import found_wrong


@pytest.mark.parametrize("first", range(0, 20_000, 200))
def test_changed_files_are_read_or_refused_soon(tmp_path, first):
    assert found_wrong(tmp_path, range(first, first + 200)) == []
