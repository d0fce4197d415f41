"""Scene files of one's own, for tests of what is recorded of a scene."""

from cbsr_qa.config.loader import Loaded, load_scene_plan, load_sensor_type
from cbsr_qa.config.scene_checks import check_plan
from cbsr_qa.domain.plan.scene_plan import ScenePlan

HEAD = """[scene]
name = "mine"
current_mA = 0.4
frame_period_s = 2.5
sheet_mesh_size_mm = 8.0

[sensor]
sensor_type = "disc-100mm"
material = "cbsr-8wt"

[recording]
seed = 7
duration_s = 100.0

"""
PIEZORESISTIVE = '[[effects]]\nname = "piezoresistivity"\n'


def load_table(x_mm=0.0, y_mm=0.0, strain_percent=20.0, start_s=20.0, hold_s=30.0, **more):
    keys = {"x_mm": x_mm, "y_mm": y_mm, "strain_percent": strain_percent, "start_s": start_s, "hold_s": hold_s}
    return "[[loads]]\n" + "".join(f"{key} = {value}\n" for key, value in (keys | more).items()) + "\n"


def written(folder, text, name="mine.toml"):
    path = folder / name
    path.write_text(text)
    return path


def checked(path) -> Loaded[ScenePlan]:
    """Load a scene as its commands do."""
    loaded = load_scene_plan(path)
    check_plan(loaded, load_sensor_type(loaded.value.sensor_type or "disc-100mm", near=loaded.folder).value)
    return loaded
