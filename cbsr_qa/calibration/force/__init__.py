"""How a sensor's readings become newtons: learning, templates, validity."""
