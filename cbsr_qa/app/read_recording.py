"""Reading a recording for a use other than the analysis of its events."""

from pathlib import Path

from cbsr_qa.app.analyse import guarded, recognised
from cbsr_qa.domain.recording import ReadOptions, Recording
from cbsr_qa.plugins import Plugins


def read_recording_file(path: Path, plugins: Plugins, *, format_: str | None, dataset: str | None) -> Recording:
    """Read one recording in any format that is known here.

    Parameters
    ----------
    format_ : name of a format; None to let the plugins recognise the file.
    dataset : one of several data sets in a file; None to take the only one.

    Raises
    ------
    RecordingError, PluginError
        If the file cannot be read, nothing in it can be used, or its format is unknown.
    """
    reader, name = recognised(path, format_, plugins)
    return guarded(path, name, lambda: reader.read(path, ReadOptions(dataset)))
