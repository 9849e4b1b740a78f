from .along_signal import constant_table as constant_table
