"""Calibration and quality assurance of soft pressure sensors read by electrical impedance tomography.

Importing this package loads nothing heavy: no scipy, no database, no plugin. Everything a plugin author
needs is in :mod:`cbsr_qa.domain` (the words of the trade) and :mod:`cbsr_qa.plugin` (what to implement, and
how to be found).
"""

from typing import Final

__version__: Final = "0.1.0"
