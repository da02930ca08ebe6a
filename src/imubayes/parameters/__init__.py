"""Parameters: what they are called, in which unit, and what was believed before the data."""
