"""The canonical cases: lines a user would type, in one folder each.

``{inputs}`` stands for the folder of input files, ``{shared}`` for the recordings beside the project,
``{run:SERIAL}`` for the latest run of a sensor. Lines may end with any exit code, which is part of what is compared.
"""

from typing import Final

_RUN: Final = "cbsr-qa run --station simulated --recipe {inputs}/short.toml"
_FLEET: Final = "--database var/fleet-demo.db"
_TANK: Final = "{shared}/tank"
_BOARD: Final = "{shared}/black_sensor"
_STRIP: Final = "cbsr-qa run --station simulated-strip --recipe {inputs}/quick-look.toml"
_CHARTS: Final = f"cbsr-qa charts --station station-A --recipe each-on-one-station {_FLEET}"
_GROUPS: Final = ("calibration", "limits", "scene", "reproduce", "station", "plugins", "db", "verdict")
_COMMANDS: Final = (
    *("run", "analyse", "report", "export", "compare", "stability", "frontier", "gauge", "charts"),
    *("calibration show", "calibration verify", "calibration export", "calibration apply", "limits propose"),
    *("scene run", "scene explain", "reproduce paper", "station check", "plugins list"),
    *("db upgrade", "db status", "db changes", "verdict override"),
)

CASES: Final[dict[str, tuple[str, ...]]] = {
    "help": tuple(f"cbsr-qa {command} --help" for command in ("", *_GROUPS, *_COMMANDS)),
    "simulated": (
        "cbsr-qa run --station simulated --recipe nine-locations --serial S-1 --dry-run",
        "cbsr-qa run --station simulated --recipe nine-locations --serial S-1 --dry-run --json",
        "cbsr-qa run --station simulated --recipe nine-locations --serial S-1 --batch 41 --seed 7 --operator Zoe",
        "cbsr-qa report S-1 --to again --json",
        "cbsr-qa calibration show var/calibrations/S-1-*.h5",
        "cbsr-qa calibration show var/calibrations/S-1-*.h5 --json",
        "cbsr-qa calibration verify var/calibrations/S-1-*.h5",
        "cbsr-qa calibration verify var/calibrations/S-1-*.h5 --json",
        "cbsr-qa calibration export var/calibrations/S-1-*.h5 --output sensor.json",
        "cbsr-qa calibration export sensor.json --output again.h5",
        "cbsr-qa calibration export var/calibrations/S-1-*.h5 --firmware --output firmware.json",
        'cbsr-qa export S-1 --phase "nine locations" --to tour.h5',
        "cbsr-qa export S-1 --to whole.h5 --json",
        "cbsr-qa analyse tour.h5",
        "cbsr-qa analyse tour.h5 --json --no-report",
        "cbsr-qa analyse tour.h5 --reconstruction greit --option noise_figure=0.7",
        "cbsr-qa calibration apply var/calibrations/S-1-*.h5 tour.h5",
        "cbsr-qa calibration apply var/calibrations/S-1-*.h5 tour.h5 --json",
        "cbsr-qa calibration apply var/calibrations/S-1-*.h5 tour.h5 --place 5 7 --output forces.csv",
        "cbsr-qa db status --json",
        "cbsr-qa db changes",
        'cbsr-qa verdict override {run:S-1} fail --operator Zoe --why "scratched"',
        "cbsr-qa report S-1 --to overridden",
    ),
    "tries": (
        "cbsr-qa run --station simulated --recipe {inputs}/strict.toml --serial T-1 --batch 41",
        f"{_RUN} --serial T-1 --batch 41 --operator Zoe --json",
        f'{_RUN} --serial T-1 --batch 42 --operator Zoe --why "limits of November"',
        "cbsr-qa report T-1 --json",
        "cbsr-qa db changes --json",
        "cbsr-qa db status",
    ),
    "overridden": (
        "cbsr-qa run --station simulated --recipe {inputs}/strict.toml --serial O-1 --seed 2",
        'cbsr-qa verdict override {run:O-1} pass --by Zoe --why "no outcome is named"',
        "cbsr-qa verdict override nowhere --outcome pass --by Zoe --why because --json",
        'cbsr-qa verdict override {run:O-1} --outcome pass --by Zoe --why "limits of November"',
        "cbsr-qa report O-1 --to passed",
        'cbsr-qa verdict override {run:O-1} --outcome fail --by Ada --why "scratched" --json',
        "cbsr-qa report O-1 --to failed --json",
        f"{_RUN} --serial O-1 --seed 3",
        "cbsr-qa db status",
    ),
    "bench-emulated": (
        "cbsr-qa run --station bench-emulated --recipe {inputs}/short.toml --serial E-1 --seed 3 --json",
        "cbsr-qa report E-1",
    ),
    "board-emulated": (
        "cbsr-qa run --station board-emulated --recipe {inputs}/short.toml --serial B-1 --seed 3",
        "cbsr-qa report B-1 --json",
    ),
    "resumed": (
        f"ORACLE_KILL_AFTER='noise figure' {_RUN} --serial K-1 --seed 5",
        "cbsr-qa db status",
        "cbsr-qa report K-1 --to cut-off",
        "cbsr-qa run --resume {run:K-1}",
        "cbsr-qa run --resume {run:K-1}",
        "cbsr-qa report K-1 --to resumed",
    ),
    "failing": (
        "ORACLE_FAIL=load cbsr-qa plugins list",
        "ORACLE_FAIL=load cbsr-qa plugins list --json",
        "CBSR_QA_TRACEBACK=1 ORACLE_FAIL=random cbsr-qa scene run base",
        "ORACLE_FAIL=random cbsr-qa scene run base --json",
        f"CBSR_QA_TRACEBACK=1 ORACLE_FAIL=random {_RUN} --serial F-0 --seed 5",
        f"ORACLE_FAIL=phase {_RUN} --serial F-1 --seed 5",
    ),
    "broken": (
        "cbsr-qa run --station {inputs}/weak.toml --recipe {inputs}/short.toml --serial W-1 --seed 5 --dry-run",
        "cbsr-qa run --station {inputs}/weak.toml --recipe {inputs}/short.toml --serial W-1 --seed 5 --json",
        "cbsr-qa run --station {inputs}/rough.toml --recipe {inputs}/short.toml --serial R-1 --seed 5",
        "cbsr-qa report R-1",
        "cbsr-qa db status --json",
    ),
    "strip": (
        f"{_STRIP} --serial STRIP-41 --batch B41 --seed 4",
        "cbsr-qa report STRIP-41 --json",
        "cbsr-qa run --station simulated --recipe nine-locations --serial S-7 --dry-run"
        " --material var/materials/B41-*.toml",
    ),
    "own-sensor": (
        "cbsr-qa run --station simulated --recipe {inputs}/elbow-recipe.toml --sensor-type {inputs}/elbow.toml"
        " --serial E-1 --seed 1",
        "cbsr-qa report E-1 --json",
    ),
    "station": (
        "cbsr-qa station check simulated --ring-ohm 10000 --operator Zoe",
        "cbsr-qa station check simulated --no-ring --golden G-0001 --json",
        "cbsr-qa station check bench-emulated --no-ring --json",
        "cbsr-qa run --station simulated --recipe golden-check --serial G-0001 --seed 2",
    ),
    "fleets": (
        "make -s -C {checkout} fleet-demo VENV={venv} CBSR_QA_VAR=$PWD/var",
        f"cbsr-qa compare --by batch --recipe each-on-one-station {_FLEET} --json --output var/one.html",
        f"cbsr-qa compare --by station --recipe a-third-on-all-stations {_FLEET} --json",
        f"cbsr-qa compare --by batch --recipe a-third-on-all-stations {_FLEET} --margin centre_of_mass_error=0.3"
        " --detect centre_of_mass_error=0.3 --output var/alike.html",
        f"cbsr-qa compare --by period --period week --recipe a-third-on-all-stations {_FLEET} --adjust none",
        f"{_CHARTS} --reference-runs 12 --operator Zoe --why start",
        f"{_CHARTS} --output var/charts.html",
        f"{_CHARTS} --json",
        f"cbsr-qa limits propose --batch 41 --recipe each-on-one-station {_FLEET} --output limits.toml",
        f"cbsr-qa limits propose --batch 41 --recipe each-on-one-station {_FLEET} --json",
        f"cbsr-qa gauge --recipe a-third-on-all-stations {_FLEET}",
        f"cbsr-qa db changes {_FLEET} --json",
        f"cbsr-qa db status {_FLEET}",
    ),
    "gauge": (
        *(
            f"cbsr-qa run --station {station} --recipe {{inputs}}/short.toml --serial {serial} --seed {seed} --json"
            for seed, (station, serial) in enumerate(
                (station, serial)
                for station in ("simulated", "{inputs}/bench-a.toml")
                for serial in ("G-1", "G-2")
                for _ in range(2)
            )
        ),
        "cbsr-qa gauge {inputs}/gain.toml --output gauge.html",
        "cbsr-qa gauge {inputs}/gain.toml --json",
        'cbsr-qa gauge --recipe short --metric noise_figure --reference "G-1.noise_figure=0.9±0.02 1"',
        "cbsr-qa compare --by station --json",
    ),
    "recordings": (
        *(
            f"cbsr-qa analyse {_BOARD}/{name} --sensor-type disc-100mm --json"
            for name in ("expABX_100mm_9.5wt_6.csv", "test.csv", "test3.csv", "testv2_3.csv", "steady_state_UoA1.csv")
        ),
        f"cbsr-qa analyse {_BOARD}/expABCX_150mm_8.5wt_6.csv --sensor-type disc-150mm",
        f"cbsr-qa analyse {_BOARD}/res1k3_cal1.csv {_BOARD}/res1k3_cal3.csv {_BOARD}/no_batt.csv --no-report",
        f"cbsr-qa analyse {_BOARD}/steady_state_calibrate.csv --no-report",
        f"cbsr-qa analyse {_TANK}/montreal_data_1995.mat",
        f"cbsr-qa analyse {_TANK}/montreal_data_1995.mat --dataset zc_demo4 --json"
        f" --reference {_TANK}/montreal_data_1995.mat:zc_h_demo4",
        f"cbsr-qa analyse {_TANK}/ds_data_2004/objects/metal_1.txt --json"
        f" --reference {_TANK}/ds_data_2004/homogeneous/water_1.txt",
        f"cbsr-qa analyse {_TANK}/phantom_16elec_1planeB.mat --json",
    ),
    "scenes": (
        *(f"cbsr-qa scene explain {name}" for name in ("none", "base", "everything", "faulty-electrode", "strip")),
        "cbsr-qa scene explain base --json",
        "cbsr-qa scene run faulty-electrode",
        "cbsr-qa scene run faulty-electrode --seed 3 --format ert-board-csv --json",
        "cbsr-qa analyse var/scenes/faulty-electrode-seed7.h5 --json",
        "cbsr-qa analyse var/scenes/faulty-electrode-seed3.ert-board-csv.csv --sensor-type disc-100mm",
    ),
    "stability": (
        "cbsr-qa stability --json --output stability.html",
        "cbsr-qa stability --area statistics",
    ),
    "studies": (
        "cbsr-qa reproduce paper --quick --output paper.html",
        "cbsr-qa plugins list",
        "cbsr-qa plugins list --json",
    ),
    "frontier": (
        "cbsr-qa frontier --clock station --quick --budget 3h --recipe chosen.toml --output frontier.html --json",
        "cbsr-qa run --station simulated --recipe chosen.toml --serial C-1 --dry-run",
    ),
    "refusals": (
        "cbsr-qa run",
        "cbsr-qa run --station simulated --recipe nowhere --serial S-1",
        "cbsr-qa run --station nowhere --recipe nine-locations --serial S-1 --json",
        "cbsr-qa run --station simulated --recipe {inputs}/wrong-recipe.toml --serial S-1",
        "cbsr-qa run --station {inputs}/wrong-station.toml --recipe {inputs}/short.toml --serial S-1",
        "cbsr-qa run --station simulated --recipe {inputs}/short.toml --serial 'S 1'",
        "cbsr-qa run --resume nowhere",
        "cbsr-qa run --station simulated --recipe {inputs}/short.toml --serial S-1 --database mongodb://localhost",
        "cbsr-qa report S-1",
        "cbsr-qa report S-1 --json",
        "cbsr-qa analyse {inputs}/noise.csv",
        "cbsr-qa analyse nowhere.h5 --json",
        "cbsr-qa analyse {inputs}/noise.csv --reconstruction nowhere",
        "cbsr-qa calibration verify {inputs}/noise.csv",
        "cbsr-qa calibration apply {inputs}/noise.csv nowhere.h5",
        "cbsr-qa compare --by colour",
        "cbsr-qa compare --by batch",
        "cbsr-qa gauge {inputs}/short.toml",
        "cbsr-qa charts --station nowhere",
        "cbsr-qa limits propose --batch nowhere",
        "cbsr-qa scene run nowhere",
        "cbsr-qa scene explain {inputs}/short.toml",
        "cbsr-qa station check nowhere",
        "cbsr-qa plugins list --kind colour",
        "cbsr-qa db upgrade --database var/none/none.db",
        "cbsr-qa verdict override nowhere pass --operator Zoe --why because",
        "cbsr-qa frontier --budget 20furlongs",
        "cbsr-qa stability --only nowhere",
    ),
}
