"""Gauge R&R of stored runs."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .references import references_of as references_of
    from .report import gauge_outcome as gauge_outcome
    from .request import (
        GaugeRequest as GaugeRequest,
        MetricWanted as MetricWanted,
        StudyFile as StudyFile,
        read_study as read_study,
    )
    from .study import GaugeStudy as GaugeStudy, gauge as gauge

door(__name__, __file__)
