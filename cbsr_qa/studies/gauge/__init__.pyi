from .document import gauge_document as gauge_document
from .page import gauge_html as gauge_html
from .references import AgainstReferences as AgainstReferences, references_of as references_of
from .request import (
    GaugeRequest as GaugeRequest,
    MetricWanted as MetricWanted,
    StudyFile as StudyFile,
    read_study as read_study,
)
from .study import Gauge as Gauge, MetricGauge as MetricGauge, gauge as gauge
from .words import (
    deviation_words as deviation_words,
    metric_words as metric_words,
    percent as percent,
    reference_words as reference_words,
    source_words as source_words,
    study_words as study_words,
)
