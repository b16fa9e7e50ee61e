"""Line detectors of others, behind the interface of ours, so that the same scores can be told of them."""
