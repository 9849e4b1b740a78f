"""The loop whose input is updated continuously, solved by the method of steps."""
