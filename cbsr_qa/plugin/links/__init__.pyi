from .locks import AddressLock as AddressLock
from .serial_link import SerialLink as SerialLink
from .visa_link import VisaLink as VisaLink
