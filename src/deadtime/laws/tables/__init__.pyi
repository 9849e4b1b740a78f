from .constant_mode import constant_table as constant_table
