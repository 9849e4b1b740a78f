"""What every room stands on: errors, checks of arguments, text and number formats, read-only data."""
