"""Simulated scenes in memory."""

from pathlib import Path
from typing import TYPE_CHECKING, Final

from cbsr_qa.interface.frames import recording_dataset
from cbsr_qa.interface.result import Progress, Result, quiet
from cbsr_qa.studies.scenes.report import scene_outcome
from cbsr_qa.studies.scenes.run import SceneRun, SimulatedScene, simulate_to_memory
from cbsr_qa.system.clock import RealClock

if TYPE_CHECKING:
    import xarray as xr

#: Time between two messages on the frames taken.
_EVERY_S: Final = 1.0


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
    progress : receives what is being done, in words, e.g. ``print``.

    Raises
    ------
    RefusedError
        If a file is wrong, or a load or an effect is impossible.
    """
    tell, clock = progress or quiet, RealClock()
    due_s = [_EVERY_S]

    def count(done: int, of: int) -> None:
        if clock.now() >= due_s[0]:
            due_s[0] = clock.now() + _EVERY_S
            tell(f"{done} of {of} frames")

    return Scene(simulate_to_memory(str(scene), seed, tell=tell, progress=count))
