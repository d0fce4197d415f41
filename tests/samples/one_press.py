"""The shortest recipe that images a load: one press, held for 20 s."""

_RECIPE = """
[recipe]
name = "one-press"
calibrate_phases = [{calibrated}]

[[phases]]
name = "one place"
sequence = "location-grid"
strains_percent = [20.0]
trials = 1
locations_mm = [[15.0, -15.0]]
hold_s = 20.0
rest_s = 5.0
initial_rest_s = 5.0
unloaded_frames = 16
find_surface = true

[reconstruction]
method = "gauss-newton-noser"
noise_figure = 1.0
exponent = 0.25

[metrics]
{metrics}
"""


def one_press_recipe(*metrics, calibrate=False):
    """Return the recipe as TOML, with these metrics; ``calibrate``: a sensor that passes gets a calibration."""
    return _RECIPE.format(
        calibrated='"one place"' if calibrate else "", metrics="\n".join(f"{metric} = {{}}" for metric in metrics)
    )
