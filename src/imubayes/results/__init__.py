"""Results: typed records of fit, diagnosis and addition, and the one reader and writer of the result folder."""
