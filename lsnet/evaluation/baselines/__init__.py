"""Line detectors of others, behind the interface of `Detector`."""
