"""The nightly batch: inbox, workers, quarantine."""
