"""Calibration and quality assurance of soft pressure sensors read by electrical impedance tomography.

``import cbsr_qa as qa`` offers the names of its stub to notebooks and scripts; importing it loads nothing heavy: no
scipy, no database, no plugin. What a plugin author needs is in :mod:`cbsr_qa.domain` (the words of the trade) and
:mod:`cbsr_qa.plugin` (what to implement, and how to be found).
"""

from cbsr_qa.lazy import door as door

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = door(__name__, __file__)
