"""A short simulated run with its analysis, for metrics and sections to be tried on."""

from functools import cache
from typing import Any, Final

from cbsr_qa.analysis.evaluate import evaluate_run
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.plugin import RunResult
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.studies.simulated import configuration_of, copy_shipped, simulate_run
from cbsr_qa.system.clock import Stages

_RECIPE: Final[dict[str, Any]] = {
    "recipe": {"name": "example", "calibrate_phases": ["three places"]},
    "phases": [
        {
            "name": "three places",
            "sequence": "location-grid",
            "locations_mm": [[0, 0], [30, 0], [0, 30]],
            "strains_percent": [20.0],
            "hold_s": 10.0,
            "rest_s": 10.0,
            "initial_rest_s": 30.0,
        }
    ],
    "reconstruction": {"method": "gauss-newton-noser", "noise_figure": 1.0},
    "metrics": {"centre-of-mass-error": {}, "applied-force": {}},
    "limits": [{"measurement": "centre_of_mass_error", "unit": "mm", "upper": 6.5}],
}


@cache
def example_result() -> RunResult:
    """Return a run of three presses on the shipped simulated station, analysed; always the same one."""
    plugins = discover()
    configuration = configuration_of(copy_shipped(DocumentKind.STATION, "simulated"), _RECIPE, seed=1)
    record, _ = simulate_run(configuration, "EXAMPLE-1", plugins)
    conclusion = evaluate_run(record, configuration.recipe, plugins, Stages())
    return RunResult(
        record,
        conclusion.observation,
        conclusion.measurements,
        conclusion.verdict,
        calibration=None,
        calibration_why="an example is not calibrated",
        warnings=conclusion.warnings,
    )
