"""Evaluation of detectors: data sets, metrics, reports."""
