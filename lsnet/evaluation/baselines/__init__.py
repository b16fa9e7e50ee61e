"""Other line detectors with the interface of `Detector`."""
