"""Simulated scenes in memory."""

from pathlib import Path
from typing import TYPE_CHECKING

from cbsr_qa.interface.frames import recording_dataset
from cbsr_qa.interface.result import Progress, Result, quiet
from cbsr_qa.studies.scenes import SceneRun, SimulatedScene, scene_outcome, simulate_to_memory

if TYPE_CHECKING:
    import xarray as xr


class Scene(Result[SceneRun]):
    """A simulated scene; ``result.loads`` holds the true places and depths."""

    def __init__(self, simulated: SimulatedScene) -> None:
        super().__init__(scene_outcome(simulated.run))
        self.recording = simulated.recording
        self.sensor_type = simulated.sensor_type

    def frames(self) -> "xr.Dataset":
        """Return the frames with their coordinates; see :meth:`Run.frames`."""
        return recording_dataset(self.recording, self.sensor_type, f"scene {self.result.scene}")


def simulate_scene(scene: str | Path, *, seed: int | None = None, progress: Progress | None = None) -> Scene:
    """Simulate a scene in memory; ``cbsr-qa scene run`` writes the same frames to a file.

    Parameters
    ----------
    scene : file or shipped name, e.g. ``"faulty-electrode"``.
    seed : by default the scene's own.

    Raises
    ------
    RefusedError
        If a file is wrong, or a load or an effect is impossible.
    """
    return Scene(simulate_to_memory(str(scene), seed, tell=progress or quiet))
