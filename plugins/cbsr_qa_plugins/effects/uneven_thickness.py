"""Uneven thickness of the sheet."""

from cbsr_qa.simulate.fields import UnevenSheet


class UnevenThickness(UnevenSheet):
    """The thickness is uneven: a thicker place conducts better, and the same depth is less strain there."""

    quantity = "thickness"
