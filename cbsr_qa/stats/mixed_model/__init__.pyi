from .model import Fit as Fit, fit as fit
