"""Calibration dates of instruments."""

from datetime import date

from cbsr_qa.app.gate.request import Asked, Finding


def instruments_in_date(asked: Asked) -> Finding:
    """Look for instruments whose date in the station file has passed."""
    today = asked.now.date()
    dated = [spec for spec in asked.configuration.station.instruments if spec.calibration_due]
    late = [
        f"{one.role} ({one.driver}) was due on {one.calibration_due}"
        for one in dated
        if past_due(one.calibration_due, today)
    ]
    if late:
        remedy = "have it calibrated and give the new calibration_due in the station file"
        return Finding(False, f"the calibration of {', '.join(late)}", remedy)
    if not dated:
        return Finding(True, "no instrument states a calibration_due")
    first = min(str(spec.calibration_due) for spec in dated)
    return Finding(True, f"no instrument is due before {first}")


def past_due(calibration_due: str | None, today: date) -> bool:
    """Whether an instrument is past its calibration date; the day itself is not."""
    return calibration_due is not None and date.fromisoformat(calibration_due) < today
