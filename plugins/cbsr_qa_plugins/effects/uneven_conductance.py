"""Uneven conductance of the sheet."""

from cbsr_qa.simulate.fields import UnevenSheet


class UnevenConductance(UnevenSheet):
    """The material's own conductance is uneven: it carries more current where it conducts better.

    The mean inter-electrode resistance stays the material's.
    """

    quantity = "conductance"
