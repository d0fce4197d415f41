"""Our own export of a run, HDF5 (format ``cbsr-recording``)."""

from pathlib import Path

from cbsr_qa.analysis.recording_file import SIGNATURE, read_recording
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.recording import ReadOptions, Recording


class CbsrRecording:
    """Reads what ``cbsr-qa export`` writes."""

    def recognises(self, path: Path, head: bytes) -> bool:
        """Tell by HDF5's own signature and our file ending; another HDF5 file is refused by name when read."""
        return head.startswith(SIGNATURE)

    def datasets(self, path: Path) -> tuple[str, ...]:
        """Such a file is one data set."""
        return ()

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read a file; RecordingError where it is damaged, edited, or of a later version."""
        if options.dataset:
            raise RecordingError(f"{path.name} is one data set; it has none named {options.dataset!r}")
        return read_recording(path)
