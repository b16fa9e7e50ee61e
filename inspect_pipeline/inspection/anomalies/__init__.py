"""Rules that find candidate anomalies in the rows of a flight."""
