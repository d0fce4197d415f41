"""What a converter acts on."""

from typing import Final

#: Effects on readings before they are converted.
BEFORE_CONVERSION: Final = (
    "voltmeter-input",
    "measurement-noise",
    "electrode-noise",
    "johnson-noise",
    "mains-hum",
    "reading-memory",
    "reading-offset",
)
