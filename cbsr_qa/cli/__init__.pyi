from .calibration import app as app
from .main import ended as ended, guarded as guarded
from .options import plugin_options as plugin_options
from .output import asked as asked, operator_at_terminal as operator_at_terminal
