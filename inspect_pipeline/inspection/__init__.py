"""Spans, coverage and anomalies, computed from the rows of a flight."""
