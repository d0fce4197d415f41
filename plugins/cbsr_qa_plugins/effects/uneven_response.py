"""Uneven response of the sheet."""

from cbsr_qa.simulate.fields import UnevenSheet


class UnevenResponse(UnevenSheet):
    """The response to strain is uneven: the same strain changes the conductance more here than there."""

    quantity = "response"
