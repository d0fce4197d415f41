import numpy as np
import pytest

from cbsr_qa.testing.numerics import assert_adjoint, assert_expected_order


def test_a_rate_is_read_from_errors_that_have_it():
    sizes = [0.4, 0.2, 0.1]
    assert_expected_order([3 * size**2 for size in sizes], sizes, 2)
    with pytest.raises(AssertionError, match=r"order 1\.000 instead of 2"):
        assert_expected_order(sizes, sizes, 2)
    with pytest.raises(AssertionError, match=r"order 3\.000 instead of 2"):
        assert_expected_order([size**3 for size in sizes], sizes, 2)


@pytest.mark.parametrize("errors", [[1.0, 0.5], [1.0, 0.0, 0.1], [1.0, float("nan"), 0.1]])
def test_a_rate_is_not_read_from_nothing(errors):
    with pytest.raises(ValueError, match="rate"):
        assert_expected_order(errors, [0.4, 0.2, 0.1][: len(errors)], 1)


def test_adjoint_of_a_matrix_is_its_transpose():
    matrix = np.random.default_rng(3).standard_normal((4, 7))
    assert_adjoint(lambda x: matrix @ x, lambda y: matrix.T @ y, (7,), (4,))
    with pytest.raises(AssertionError, match="differ"):
        assert_adjoint(lambda x: matrix @ x, lambda y: matrix.T @ y * 1.001, (7,), (4,))
    with pytest.raises(AssertionError, match="shapes"):
        assert_adjoint(lambda x: matrix @ x, lambda y: y, (7,), (4,))
