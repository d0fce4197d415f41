"""Kit for plugin authors: conformance checks, convergence-order and adjoint assertions."""
