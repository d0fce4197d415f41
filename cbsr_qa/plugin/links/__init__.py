"""How drivers reach their instruments; every failure is an InstrumentError."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .locks import AddressLock as AddressLock
    from .serial_link import SerialLink as SerialLink
    from .visa_link import VisaLink as VisaLink

door(__name__, __file__)
