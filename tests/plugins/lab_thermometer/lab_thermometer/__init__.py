"""A room thermometer, and a metric that needs it."""

from cbsr_qa.hookspecs import Kind, hookimpl


@hookimpl
def cbsr_register(register):
    """Add an instrument and a metric."""
    register(Kind.INSTRUMENT, "lab-thermometer", "lab_thermometer.thermometer:open_thermometer")
    register(Kind.METRIC, "temperature-span", "lab_thermometer.span:TemperatureSpan")
