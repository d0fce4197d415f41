from .analyse import Analysed as Analysed, AnalyseRequest as AnalyseRequest, analyse_file as analyse_file
from .document import parameter_document as parameter_document
