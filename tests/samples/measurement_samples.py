"""What the metrics say of the loads of the sample run, some of it judged."""

import numpy as np
from sensor_samples import INDENTER

from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.eit.imaging.shape import area_overlap_percent, centre_of_mass_error_mm, shape_deviation_mm2


def sample_measurements(loads):
    found = []
    for load in loads:
        wanted = load.record.load
        place = (wanted.x_mm, wanted.y_mm)
        about = {"phase": load.phase, "location": wanted.label, "trial": wanted.trial, "load": load.record.index}
        for view in load.masks:
            main = abs(view.fraction - 0.85) < 1e-9
            about["qualifier"] = "" if main else f"mask {100 * view.fraction:g} %"
            blob = view.sensed
            values = (
                (
                    "centre_of_mass_error",
                    "mm",
                    blob and centre_of_mass_error_mm(blob, INDENTER.footprint_at(*place)),
                    "",
                ),
                (
                    "area_overlap",
                    "%",
                    blob and area_overlap_percent(blob, INDENTER.footprint_at(*place)),
                    "good; exact clipping",
                ),
                ("shape_deviation", "mm²", blob and shape_deviation_mm2(blob, INDENTER.footprint_at(*place)), ""),
            )
            found += [
                Measurement(n, v, u, how=h if v is not None else "not detected", **about) for n, u, v, h in values
            ]
        found += [
            Measurement(name, value, "mm" if name == "position_error" else "1", **{**about, "qualifier": ""})
            for name, value in (
                ("amplitude_response", 0.9),
                ("position_error", 0.04 * np.hypot(*place)),
                ("resolution", 0.3),
                ("shape_deformation", 0.05),
                ("ringing", 0.2),
                ("false_regions", 0.0),
                ("detectability", 40.0),
            )
        ]
    found += [
        Measurement("two_touch_resolution", 29.0, "mm", how="contours at 85 %; steps of 0.5 mm"),
        Measurement("merged_loads", 1.0, "1"),
        Measurement("size_response", 0.1, "1", qualifier="centre", how="flat"),
        *(
            Measurement("region_area", area, "mm²", qualifier=f"centre, target of {diameter} mm")
            for diameter, area in ((8, 131.0), (13, 133.0), (20, 142.0))
        ),
    ]
    found += [
        Measurement("force_error_sd", 0.1, "N", 0.02, qualifier="place known", how="10 loads"),
        Measurement("repeatability", 1.4, "%", 0.3, how="of the place's span"),
        Measurement("apparent_modulus", 132.0, "kPa", 0.5, how="9 locations"),
        *(Measurement("apparent_modulus", 130.0 + k, "kPa", location=f"L{k}") for k in range(9)),
    ]
    limit = Limit("centre_of_mass_error", "mm", None, 5.0, marginal=0.5, phase="nine")
    judged = [
        m.judge(limit) if (m.name, m.phase, m.qualifier) == ("centre_of_mass_error", "nine", "") else m for m in found
    ]
    judged.append(
        Measurement("noise_figure", 1.07, "1", 0.08, phase="noise").judge(Limit("noise_figure", "1", 0.5, 1.5))
    )
    judged.append(Measurement("channel_snr", 58.3, "dB", qualifier="median", how="208 used readings"))
    judged += [
        Measurement("contact_resistance", 18.1e3 + 900 * np.sin(k), "Ω", 40.0, qualifier=f"pair {k}-{(k + 1) % 16}")
        for k in range(16)
    ]
    return tuple(judged)
