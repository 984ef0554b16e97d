"""Data sets in layouts of their own, read as frames."""
