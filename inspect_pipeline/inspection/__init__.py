"""Coverage of power-line spans and candidate anomalies, computed from the index rows of a flight."""
