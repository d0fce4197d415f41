"""A regularisation parameter in a JSON document."""

from typing import Any

from cbsr_qa.domain.reconstruction import ParameterChoice


def parameter_document(choice: ParameterChoice) -> dict[str, Any]:
    """Return what it is, what chose it and why, and the noise figure of the matrix (Adler et al. 2009 form)."""
    return {
        "name": choice.name,
        "value": choice.value,
        "criterion": choice.criterion or None,
        "reason": choice.how,
        "noise_figure": choice.noise_figure,
    }
