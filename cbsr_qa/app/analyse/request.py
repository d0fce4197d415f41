"""What to analyse of a recording or a table, and how."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cbsr_qa.analysis.recording.analysis import DEFAULT_RECONSTRUCTION
from cbsr_qa.analysis.recording.table_files import TableForm
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.system.foreign import open_foreign


@dataclass(frozen=True, slots=True)
class AnalyseRequest:
    """What to analyse, and how.

    Parameters
    ----------
    format : name of a recording plugin; None to let the plugins recognise the file.
    sensor_type : file or shipped name; None for the one the recording states, else the nominal disc.
    dataset : one of several data sets in a file.
    reference : file, and a data set in it, with the unloaded domain; its format is recognised separately.
    correct_carry_over : None to decide by the estimate.
    report : whether to write a report.
    reconstruction, options : plugin that images the events (None for the usual one), and its options.
    table : how a table of frames is read; None if the file is a recording.
    """

    format: str | None = None
    sensor_type: str | None = None
    dataset: str | None = None
    reference: tuple[Path, str | None] | None = None
    correct_carry_over: bool | None = None
    report: bool = True
    reconstruction: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    table: TableForm | None = None

    @property
    def chosen(self) -> PluginChoice:
        name = DEFAULT_RECONSTRUCTION if self.reconstruction is None else self.reconstruction
        return PluginChoice(name, self.options)


def digest_request(path: Path, request: AnalyseRequest) -> str:
    """Return eight digits of content and request, so that reports do not overwrite each other."""
    sha = hashlib.sha256()
    table = request.table
    others = [] if request.reference is None else [request.reference[0]]
    others += [] if table is None else [each for each in (table.pattern, table.rest) if each is not None]
    for each in (path, *others):
        with open_foreign(each) as file:
            sha.update(hashlib.file_digest(file, "sha256").digest())
    dataset = None if request.reference is None else request.reference[1]
    settings: tuple[object, ...] = (request.format, request.sensor_type, dataset, request.correct_carry_over)
    if request.reconstruction is not None or request.options:
        settings = (*settings, request.chosen.name, sorted(request.options.items()))
    if table is not None:
        settings = (*settings, table.differences, table.rest is None, table.complex_part)
    sha.update(repr(settings).encode())
    return sha.hexdigest()[:8]
