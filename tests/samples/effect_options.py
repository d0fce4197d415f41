"""Options of every effect, for tests that turn effects on."""

from typing import Any

#: What an effect cannot do without; a parameter that has a default needs no line here.
REQUIRED: dict[str, dict[str, Any]] = {
    "sheet-seat": {"error_mm": 0.1},
    "load-cell-noise": {"rms_N": 0.01},
    "unloading-spike": {"size": 0.2, "decay_s": 1.0},
    "residue": {"share": 0.1, "decay_s": 100.0},
    "hysteresis": {"width": 0.1},
    "head-edge": {"width_mm": 1.0},
    "pressure-profile": {"shape": "punch"},
    "temperature-drift": {"coefficient_per_K": 0.01},
    "load-cell-saturation": {"limit_N": 7.0},
    "applicator-position-error": {"error_mm": 0.1},
    "backlash": {"play_mm": 0.1},
    "uneven-conductance": {"deviation": 0.1, "correlation_mm": 20.0},
    "uneven-response": {"deviation": 0.1, "correlation_mm": 20.0},
    "batch-pattern": {"rho": 0.75, "batch": "41", "deviation": 0.2, "correlation_mm": 20.0},
    "uneven-thickness": {"deviation": 0.1, "correlation_mm": 20.0},
    "contact-spread": {"deviation": 0.1},
    "contact-drift": {"deviation_per_hour": 0.1},
    "pin-position-error": {"error_mm": 0.1},
    "reading-memory": {"share": 0.1},
    "mains-hum": {"amplitude_V": 0.01},
    "quantisation": {"range_V": 2.0, "bits": 12},
    "converter-saturation": {"range_V": 2.0},
    "reading-offset": {"offset_V": 0.01},
    "lead-resistance": {"electrode": 3, "resistance_ohm": 100.0},
    "electrode-short": {"electrodes": [3, 9]},
    "electrode-open": {"electrode": 3},
    "electrode-intermittent": {"electrode": 3, "mean_open_s": 1.0, "mean_closed_s": 1.0},
    "frame-loss": {"share": 0.1},
    "watchdog-dump": {"period_s": 60.0},
    "electrode-noise": {"electrode": 3, "relative_noise": 0.01},
}
