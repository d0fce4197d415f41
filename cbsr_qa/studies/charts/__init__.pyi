from .after_run import charts_after as charts_after
from .charting import STANDS as STANDS, UNCOUNTED as UNCOUNTED, charts_of as charts_of, standard_of as standard_of
from .charts import Charts as Charts, control_charts as control_charts
from .document import charts_document as charts_document, reference_document as reference_document
from .page import chart_words as chart_words, charts_html as charts_html
from .request import ChartsRequest as ChartsRequest, ReferencePeriod as ReferencePeriod, Retirement as Retirement
