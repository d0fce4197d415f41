"""``cbsr-qa calibrate``: a calibration from labelled presses."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import AsJson, PageOutput
from cbsr_qa.cli.output import announce, check_page, show


@command(
    "calibrate",
    prints="cbsr_qa.app.calibration.calibrate:PressesCalibrated",
    reads="cbsr_qa.app.calibration.calibrate",
)
def calibrate(
    readings: Annotated[
        Path,
        typer.Argument(
            metavar="READINGS",
            help="Table (CSV, Parquet) with one row per press below a header; or recording, one frame per press.",
        ),
    ],
    presses: Annotated[
        Path,
        typer.Option(
            help="Table of the same presses in the same order: x_mm, y_mm and, if known, depth_mm, force_N, time_s."
        ),
    ],
    sensor_type: Annotated[
        str, typer.Option(help="Sensor type; without radius_mm the radius is estimated at a scale of 1.")
    ],
    to: Annotated[Path, typer.Option(help="Calibration file to write; must not exist yet.")],
    pattern: Annotated[
        Path | None,
        typer.Option(
            help="Table source,sink,plus,minus (electrodes from 0) with one row per column of READINGS."
            " Not for a recording, which has the pattern of the sensor type."
        ),
    ] = None,
    differences: Annotated[
        bool, typer.Option("--differences", help="READINGS are differences from the unloaded sheet.")
    ] = False,
    rest: Annotated[
        Path | None,
        typer.Option(
            help="Frames of the unloaded sheet, with the columns of READINGS; READINGS must then hold whole frames."
        ),
    ] = None,
    row_shift: Annotated[
        int,
        typer.Option(help="Number of rows by which places stand below their readings; the ends are left out."),
    ] = 0,
    standards: Annotated[
        Path | None,
        typer.Option(
            help="TOML file with a standards table, or a station's: certificates that the forces are traced to."
        ),
    ] = None,
    output: PageOutput = None,
    as_json: AsJson = False,
) -> int:
    """Calibrate a sensor from presses at known places, made by a robot, another rig or by hand.

    Finds how the sheet lies in the frame of the places, learns force and depth where they are known, and states
    the error at presses left out of the fit.
    """
    from cbsr_qa.analysis.recording.press_files import PressFiles
    from cbsr_qa.app.calibration.calibrate import calibrate_from_presses

    check_page(output)
    files = PressFiles(readings, presses, sensor_type, pattern, differences, rest, row_shift)
    return show(calibrate_from_presses(files, to, standards=standards, tell=announce), output=output, as_json=as_json)
