"""Decide about anomalies and correct lines in a browser on this machine."""
