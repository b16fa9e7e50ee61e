"""Lines followed over the frames of a camera."""
