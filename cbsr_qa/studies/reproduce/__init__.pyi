from .compare import ComparedTable as ComparedTable, Comparison as Comparison, deviations_agree as deviations_agree
from .draw import agreement_sign as agreement_sign, ours_text as ours_text, printed_text as printed_text
from .reproduce import Reproduction as Reproduction, published as published, reproduce_paper as reproduce_paper
