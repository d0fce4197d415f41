"""What ``analyse`` says of recordings that are no part of this package; each is analysed once a session."""

import json
from functools import cache
from pathlib import Path

from cbsr_qa.app.analyse.analyse import analyse_file
from cbsr_qa.app.analyse.request import AnalyseRequest
from cbsr_qa.report.document import json_document


@cache
def document(path: Path, dataset: str | None = None, reference: Path | None = None) -> dict:
    request = AnalyseRequest(
        report=False, dataset=dataset, reference=None if reference is None else (reference, None)
    )
    analysed = analyse_file(path, request)
    told = json.loads(json.dumps(json_document(analysed), allow_nan=False))
    return {**told, "exit": analysed.exit_code}
