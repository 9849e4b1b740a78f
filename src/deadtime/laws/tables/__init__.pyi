from .constant_mode import constant_table as constant_table
from .known_signal import future_rows as future_rows
