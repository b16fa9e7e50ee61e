"""Where each frame was taken and where the camera looked."""
