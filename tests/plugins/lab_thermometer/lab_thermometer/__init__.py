"""A room thermometer, a metric that needs it, and an effect for scenes."""

from cbsr_qa.plugin.hooks import Kind, hookimpl


@hookimpl
def cbsr_register(register):
    """Add an instrument, a metric and an effect."""
    register(Kind.INSTRUMENT, "lab-thermometer", "lab_thermometer.thermometer:open_thermometer")
    register(Kind.METRIC, "temperature-span", "lab_thermometer.span:TemperatureSpan")
    register(Kind.EFFECT, "room-draught", "lab_thermometer.draught:RoomDraught")
