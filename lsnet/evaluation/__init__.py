"""Evaluation: data sets, metrics, reports."""
